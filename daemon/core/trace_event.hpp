// SPDX-License-Identifier: Apache-2.0
// One thing that happened to one message: what `slam-gatewayctl watch` shows. Values only; the JSON
// of it is written by daemon/control/trace_json.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "daemon/core/traffic_event.hpp"

namespace slamgw {

struct TraceEvent {
  enum class Kind : std::uint8_t {
    arrived,       ///< a robot's message came
    repeat,        ///< it came again and did not go up
    stored,        ///< the disk has it
    published,     ///< the broker has it; QoS 0: handed to the network
    acknowledged,  ///< the robot got its acknowledgement
    refused,       ///< by the gateway or by the broker
    command,       ///< a message to a robot came from the broker or an operator
    sent,          ///< it was handed to the radio; several times when it is repeated
    outcome,       ///< how a command ended
  };

  Kind kind = Kind::arrived;
  WallTime at{};
  Direction direction = Direction::up;
  std::optional<Mesh> mesh{};
  std::string robot{};
  std::string address{};  ///< of the robot on `mesh`; empty: not known
  std::string topic{};
  std::string type{};
  std::optional<Qos> qos{};
  WireFacts wire{};
  std::optional<std::size_t> bytes{};  ///< of the payload
  std::optional<RadioFacts> radio{};
  /// Since the message arrived, or the command came.
  std::optional<std::chrono::microseconds> latency{};
  CommandId command = CommandId::none;
  std::optional<CommandResult> outcome{};
  std::string why{};  ///< of `refused`, `outcome`, `arrived` (under rejected/); may be empty
  std::optional<Update> update{};
  std::optional<Bytes> payload{};  ///< of `arrived` and `command`
};

/// As in the JSON.
constexpr std::string_view to_string(TraceEvent::Kind kind) {
  switch (kind) {
    case TraceEvent::Kind::arrived: return "arrived";
    case TraceEvent::Kind::repeat: return "repeat";
    case TraceEvent::Kind::stored: return "stored";
    case TraceEvent::Kind::published: return "published";
    case TraceEvent::Kind::acknowledged: return "acknowledged";
    case TraceEvent::Kind::refused: return "refused";
    case TraceEvent::Kind::command: return "command";
    case TraceEvent::Kind::sent: return "sent";
    case TraceEvent::Kind::outcome: return "outcome";
  }
  return {};
}

}  // namespace slamgw
