// SPDX-License-Identifier: Apache-2.0
// The actions of BleMesh and its parts, which BleMeshShell performs.
#pragma once

#include <optional>
#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/operator_order.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

/// Put the mesh's database on disk; answered by on_stored. Holds secrets.
struct StoreMesh {
  NodeDatabase database;
  bool is_new = false;  ///< of a new mesh: it must not replace a file
};
/// The radio has heard a robot, in a mesh that several gateways share.
struct HeardRobot {
  std::string robot;
  std::optional<RadioFacts> radio;  ///< empty for a heartbeat
};
/// An operator's order has ended. Sent once for each order.
struct OrderEnded {
  std::uint64_t id = 0;
  OrderAnswer answer;
};

using MeshAction =
    std::variant<WriteSerial, ReopenPort, StoreMesh, HeardRobot, OrderEnded, MeshEvent>;
using MeshActions = ActionQueue<MeshAction>;

/// The state of the link to the radio, from the radio's events. BleMesh keeps it.
struct LinkState {
  bool is_up = false;
  bool is_starting = true;  ///< the radio has not said yet whether the link is up
  std::string down_reason = "not started";
  std::uint16_t source = 0;  ///< the address that the radio sends from
};

}  // namespace slamgw::ble
