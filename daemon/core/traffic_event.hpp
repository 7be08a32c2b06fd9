// SPDX-License-Identifier: Apache-2.0
// A robot message as it passes the core, and the later steps of its delivery, for the log and the
// trace.
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
  std::optional<RadioFacts> radio{};
  CommandId command = CommandId::none;  ///< set for a command on its way down
  bool had_stray_octet = false;         ///< one stray octet followed the `update`
  bool is_rejected = false;             ///< `payload.update` could not read the payload
  bool is_proven = true;                ///< see Report
};

/// A step of delivery with one message of a robot. Reported only while an operator watches.
/// `refused`: the broker does not take the message, or it was QoS 0 and dropped.
struct DeliveryStep {
  enum class Kind : std::uint8_t { stored, published, refused };
  Kind kind = Kind::published;
  std::string topic;
  Qos qos = Qos::at_most_once;
  std::size_t bytes = 0;  ///< of the payload
  RequiredMesh mesh;
  Receipt receipt = no_receipt;  ///< may be none, or may have fired already
  TimePoint submitted{};
  std::string why{};  ///< why the message was refused
};

}  // namespace slamgw
