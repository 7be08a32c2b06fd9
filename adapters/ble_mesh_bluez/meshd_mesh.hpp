// SPDX-License-Identifier: Apache-2.0
// The BLE mesh behind BlueZ's bluetooth-meshd: BleMesh on a MeshdRadio, with the inputs of D-Bus.
// Called by MeshdAdapter.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "adapters/ble_mesh_bluez/meshd_radio.hpp"
#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"

namespace slamgw::ble {

using MeshdAction = std::variant<MeshdRequest, MeshAction>;

class MeshdMesh final : public BleMesh {
 public:
  /// Arguments as for BleMesh. `random` makes the UUID and the device key of the gateway's node.
  MeshdMesh(const Settings& settings, TopicScheme topics, RobotNames names,
            const std::optional<NodeDatabase>& database, MeshdRadio::RandomSource random)
      : BleMesh(settings, std::move(topics), std::move(names), database,
                std::make_unique<MeshdRadio>(MeshdSettings{settings.heard_groups(), settings.ttl,
                                                           database ? database->life.radio : ""},
                                             radio_keys(database), std::move(random))) {}

  void on_meshd(MeshdEvent& event, TimePoint now) {
    meshd().on_event(event, now);
    settle(now);
  }

  std::optional<MeshdAction> next_action() {
    if (auto request = meshd().next_request()) return MeshdAction(std::move(*request));
    if (auto action = BleMesh::next_action()) return MeshdAction(std::move(*action));
    return std::nullopt;
  }

 private:
  MeshdRadio& meshd() { return static_cast<MeshdRadio&>(radio()); }
};

}  // namespace slamgw::ble
