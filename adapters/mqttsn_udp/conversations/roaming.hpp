// SPDX-License-Identifier: Apache-2.0
// Robots that come from another gateway or go to one (docs/fleet.md). A CONNECT that takes up a
// session waits until the other gateway has handed it over; then it goes the way of any CONNECT.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"
#include "adapters/mqttsn_udp/name_rules.hpp"
#include "adapters/mqttsn_udp/output.hpp"

namespace slamgw::mqttsn {

class Roaming {
 public:
  /// For another gateway to hand a session over. Then the client gets a fresh one, as it would if
  /// that gateway were dead.
  static constexpr std::chrono::milliseconds patience{1500};
  /// CONNECTs beyond it do not wait.
  static constexpr std::size_t max_waiting = 256;

  struct WaitingConnect {
    Peer peer;
    LocalAddress local;
    Connect connect;
    std::uint64_t fingerprint = 0;
    std::string robot;
    TimePoint until{};
  };
  using ServedElsewhere = std::function<bool(const std::string& robot)>;

  Roaming(const NameRules& rules, ClientTable& clients, Output& output, Lifecycle& lifecycle)
      : rules_(rules), clients_(clients), output_(output), lifecycle_(lifecycle) {}

  void ask(ServedElsewhere served_elsewhere) { served_elsewhere_ = std::move(served_elsewhere); }
  /// True when the CONNECT waits: a repetition of one that does, or a client whose session may be
  /// at another gateway.
  bool takes(const Peer& peer, const LocalAddress& local, const Connect& connect,
             std::uint64_t fingerprint, TimePoint now);
  /// The robot is this gateway's: its CONNECT, if one waits.
  std::optional<WaitingConnect> take(const std::string& robot);
  std::optional<WaitingConnect> take_overdue(TimePoint now);
  std::optional<TimePoint> deadline() const;

  /// The robot is with another gateway: its session ends here without will and without a word.
  /// Commands that wait are refused. What the other gateway needs, if the session was to be kept.
  std::optional<SessionSnapshot> give_up(const std::string& robot, TimePoint now);

 private:
  const NameRules& rules_;
  ClientTable& clients_;
  Output& output_;
  Lifecycle& lifecycle_;
  ServedElsewhere served_elsewhere_ = [](const std::string&) { return false; };
  std::deque<WaitingConnect> waiting_;  // in the order they came
};

}  // namespace slamgw::mqttsn
