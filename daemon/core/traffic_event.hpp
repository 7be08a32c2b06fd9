// SPDX-License-Identifier: Apache-2.0
// A robot message as it passes the core, for the log and the trace.
#pragma once

#include <optional>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/normalizer.hpp"

namespace slamgw {

enum class Direction : std::uint8_t { up, down };

struct TrafficEvent {
  Direction direction = Direction::up;
  std::optional<Mesh> mesh;  ///< nothing for a command to a robot that is known on no mesh
  std::string robot;
  std::string type;  ///< the whole topic if that is outside a robot's tree
  std::string topic;
  Bytes payload;  ///< as published, or as it came down
  Qos qos = Qos::at_most_once;
  std::optional<Update> update;  ///< set when `type` is `update` and the payload could be read
  WallTime wall{};
  TimePoint at{};                ///< when it arrived in the gateway
  Receipt receipt = no_receipt;  ///< on its way up; fires when the broker or the disk has it
  WireFacts wire{};
  std::string address{};  ///< see Report
  std::optional<RadioFacts> radio{};
  CommandId command = CommandId::none;  ///< set for a command on its way down
  bool had_stray_octet = false;         ///< one stray octet followed the `update`
  bool is_rejected = false;             ///< `payload.update` could not read the payload
  bool is_proven = true;                ///< see Report
};

}  // namespace slamgw
