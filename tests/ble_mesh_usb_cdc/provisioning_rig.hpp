// SPDX-License-Identifier: Apache-2.0
// A MeshRig whose board has devices in reach, which send their beacons while it scans.
#pragma once

#include <nlohmann/json.hpp>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {

struct ProvisioningRig : MeshRig {
  explicit ProvisioningRig(Settings settings = {},
                           std::optional<NodeDatabase> database = test_database(),
                           RobotNames names = RobotNames())
      : MeshRig(std::move(settings), database, std::move(names)),
        initial(database.value_or(NodeDatabase{})) {}

  FakeDevice& add(std::uint8_t number) { return board.devices.add(number); }

  /// Runs for `time`, with beacons each half second.
  void pass(Duration time) {
    for (const TimePoint end = now + time; now < end;) {
      run_for(std::chrono::milliseconds{500});
      if (const Bytes beacons = board.devices.beacons(); !beacons.empty()) say(beacons);
    }
    run_for(std::chrono::milliseconds{100});
  }
  /// Runs until each device is configured or `limit` has passed.
  bool all_configured(Duration limit) {
    for (const TimePoint end = now + limit; now < end;) {
      if (configured() == board.devices.devices.size()) return true;
      pass(std::chrono::milliseconds{500});
    }
    return configured() == board.devices.devices.size();
  }
  /// Returns the number of configured nodes on disk.
  std::size_t configured() const {
    return static_cast<std::size_t>(
        std::ranges::count(on_disk().nodes, NodeState::configured, &Node::state));
  }
  const NodeDatabase& on_disk() const { return stored.empty() ? initial : stored.back(); }
  /// Resets devices by hand whose key the gateway does not have.
  void reset_lost_devices() {
    for (FakeDevice& device : board.devices.devices) {
      const Node* node = on_disk().find_address(device.address);
      const bool is_lost = node == nullptr || node->state == NodeState::reserved ||
                           to_hex(*node->device_key) != to_hex(device.device_key);
      if (is_lost) device.address = 0;
    }
  }
  std::uint64_t order(BleOrder what) {
    mesh.on_order(++last_order, std::move(what), now);
    run_for(Duration::zero());
    return last_order;
  }
  /// Returns the answer to the last order, or its error as text; null when there is none.
  nlohmann::json answer() const {
    if (answers.size() != last_order) return nullptr;
    if (!answers.back().error.empty()) return answers.back().error;
    return nlohmann::json::parse(answers.back().json);
  }

  std::uint64_t last_order = 0;
  NodeDatabase initial;
};

}  // namespace slamgw::ble
