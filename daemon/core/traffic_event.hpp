// SPDX-License-Identifier: Apache-2.0
// One robot message as operators see it: in the journal, in `slam-gatewayctl watch`.
#pragma once

#include <optional>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/update_payload.hpp"

namespace slamgw {

enum class Direction : std::uint8_t { up, down };

struct TrafficEvent {
  Direction direction = Direction::up;
  std::optional<Mesh> mesh;  ///< nothing for a command to a robot that is known on no mesh
  std::string robot;
  std::string type;  ///< the whole topic where it is not in a robot's tree
  std::string topic;
  Bytes payload;  ///< as it goes up, or came down
  Qos qos = Qos::at_most_once;
  std::optional<Update> update;  ///< when `type` is `update` and could be read
  WallTime wall{};
  TimePoint at{};     ///< arrival in the gateway
  Receipt receipt{};  ///< on its way up: fires when the broker or the disk has it
};

/// Told of each robot message that passes, in either direction.
class TrafficObserver {
 public:
  virtual ~TrafficObserver() = default;
  virtual void on_traffic(const TrafficEvent& event) = 0;
  /// The receipt of a message on its way up has fired.
  virtual void on_receipt(const Receipt&, ReceiptOutcome, TimePoint) {}
};

}  // namespace slamgw
