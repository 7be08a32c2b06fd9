// SPDX-License-Identifier: Apache-2.0
// Pings on request of an operator: a PINGREQ without a client id to an active client, which may
// answer with PINGRESP (MQTT-SN 1.2 section 6.11). Many clients do not. Called by SnGateway. Pure.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/conversations/conversation.hpp"

namespace slamgw::mqttsn {

class OperatorPings : Conversation {
 public:
  static constexpr std::size_t max_open = 16;
  static constexpr std::chrono::seconds patience{5};

  explicit OperatorPings(const Conversation& common) : Conversation(common) {}

  /// Ends with one PingEnded, which has this id.
  void ask(std::uint64_t id, const std::string& robot, TimePoint now);
  void on_pingresp(const ClientSession& session, TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  struct Open {
    std::uint64_t id = 0;
    std::string robot;
    TimePoint since{};
  };

  void end(const Open& ping, std::optional<Duration> after, const std::string& why, TimePoint now);

  std::vector<Open> open_;  ///< oldest first
};

}  // namespace slamgw::mqttsn
