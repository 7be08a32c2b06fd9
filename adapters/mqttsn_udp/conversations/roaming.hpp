// SPDX-License-Identifier: Apache-2.0
// Robots that come from another gateway (docs/fleet.md). A CONNECT that takes up a session which is
// not here waits for the note about it; then it goes the way of any CONNECT. What comes for the
// robot meanwhile waits with it.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/name_rules.hpp"
#include "adapters/mqttsn_udp/output.hpp"

namespace slamgw::mqttsn {

class Roaming {
 public:
  struct WaitingConnect {
    Peer peer;
    LocalAddress local;
    Connect connect;
    std::uint64_t fingerprint = 0;
    std::string robot;
    TimePoint until{};
    std::vector<std::pair<TimePoint, RobotMessage>> messages{};  ///< and when each came
    /// The messages, each with the time that it has waited.
    std::vector<RobotMessage> take_messages(TimePoint now);
  };
  /// Whether another gateway serves the robot, or has served it.
  using ServedElsewhere = std::function<bool(const std::string& robot)>;

  Roaming(const NameRules& rules, const ClientTable& clients, Output& output)
      : rules_(rules), clients_(clients), output_(output) {}

  void ask(ServedElsewhere served_elsewhere) { served_elsewhere_ = std::move(served_elsewhere); }
  /// True when the CONNECT waits: the client's session may be at another gateway, or an earlier
  /// CONNECT from this address waits, whose place it takes.
  bool takes(const Peer& peer, const LocalAddress& local, const Connect& connect,
             std::uint64_t fingerprint, TimePoint now);
  /// True when the message waits with its robot's CONNECT.
  bool keep(const RobotMessage& message, TimePoint now);
  bool is_waiting(const std::string& robot) const;
  /// The robot's CONNECT, if one waits.
  std::optional<WaitingConnect> take(const std::string& robot);
  std::optional<WaitingConnect> take_overdue(TimePoint now);
  std::optional<TimePoint> deadline() const;

 private:
  const NameRules& rules_;
  const ClientTable& clients_;
  Output& output_;
  ServedElsewhere served_elsewhere_ = [](const std::string&) { return false; };
  std::deque<WaitingConnect> waiting_;  // in the order they came; at most max_waiting_connects
};

}  // namespace slamgw::mqttsn
