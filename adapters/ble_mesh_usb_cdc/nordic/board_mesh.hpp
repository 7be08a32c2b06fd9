// SPDX-License-Identifier: Apache-2.0
// The BLE mesh behind Nordic's serial board: BleMesh on a BoardRadio, with the inputs of the port.
// Called by BoardAdapter.
#pragma once

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"

namespace slamgw::ble {

class BoardMesh final : public BleMesh {
 public:
  /// Arguments as for BleMesh. `random` makes the key pairs for new robots, `seed` the Echo nonces.
  BoardMesh(const Settings& settings, TopicScheme topics, RobotNames names,
            const std::optional<NodeDatabase>& database, RandomSource random, std::uint64_t seed)
      : BleMesh(settings, std::move(topics), std::move(names), database,
                std::make_unique<BoardRadio>(
                    BoardSettings{settings.address, settings.heard_groups(), settings.ttl},
                    radio_keys(database), std::move(random), seed)) {}

  void on_port_open(TimePoint now) {
    board().on_port_open(now);
    settle(now);
  }
  /// Call also when an attempt to open the port failed.
  void on_port_closed(const std::string& why, TimePoint now) {
    board().on_port_closed(why, now);
    settle(now);
  }
  void on_bytes(ByteView bytes, TimePoint now) {
    board().on_bytes(bytes, now);
    settle(now);
  }

 private:
  BoardRadio& board() { return static_cast<BoardRadio&>(radio()); }
};

}  // namespace slamgw::ble
