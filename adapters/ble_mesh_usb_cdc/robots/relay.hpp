// SPDX-License-Identifier: Apache-2.0
// `ble_mesh.relay`: sends the updates of robots on other meshes to a group, so that the robots of
// this mesh hear them. It takes the updates from the broker, whichever gateway has published them.
// Part of BleMesh.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/robots/robots.hpp"

namespace slamgw::ble {

/// Returns the number that names the sender in a relayed update: CRC-16/CCITT-FALSE of the robot's
/// id. It needs no configuration and is the same at each gateway.
std::uint16_t relayed_number_of(std::string_view robot);

struct RelayCounters {
  std::uint64_t relayed = 0;
  std::uint64_t superseded = 0;  ///< the sender sent a newer update before its turn came
  std::uint64_t dropped = 0;     ///< not an `update`, no room, or no radio
};

class Relay : private MeshPart {
 public:
  /// Maximum of robots whose last update waits for its turn.
  static constexpr std::size_t max_senders = 64;
  /// Ten messages a second leave most of the air to the robots of this mesh.
  static constexpr Duration pause = std::chrono::milliseconds{100};
  /// A segmented message to a group occupies Nordic's transport for 2.5 s, and the board refuses
  /// the next one until then; the rest is for the serial line.
  static constexpr Duration segmented_pause = std::chrono::milliseconds{2600};

  /// All references must outlive this object.
  Relay(const MeshPart& shared, const Robots& robots, const NodeTable& nodes)
      : MeshPart(shared), robots_(robots), nodes_(nodes) {}

  /// Takes a message under `<prefix>/robot/`. Only the last update of each robot waits.
  void on_robot_message(const BrokerMessage& message, TimePoint now);
  /// Drops waiting updates, which would be out of date when the link is back.
  void on_link_down();
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now) { send_due(now); }

  const RelayCounters& counters() const { return counters_; }

 private:
  struct Waiting {
    std::uint16_t sender;
    std::string robot;
    Bytes access;
  };

  bool is_for_others(std::string_view robot) const;
  void keep_last(std::string_view robot, ByteView update);
  TimePoint due(const Waiting& update) const;
  void send_due(TimePoint now);

  const Robots& robots_;
  const NodeTable& nodes_;
  std::deque<Waiting> waiting_;  ///< at most one of each sender, in the order of their turns
  TimePoint next_at_{};
  TimePoint next_segmented_at_{};
  RelayCounters counters_;
};

}  // namespace slamgw::ble
