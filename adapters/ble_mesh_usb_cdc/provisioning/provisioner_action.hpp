// SPDX-License-Identifier: Apache-2.0
// What Provisioner, and the parts that it is made of, ask of BleMesh, and know of the radio.
#pragma once

#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

/// Nodes, or their names, are different from before.
struct NodesChanged {};
struct BoardState {
  bool is_up = false;
  std::string down_reason = "not started";
  std::uint16_t source = 0;  ///< the address that it sends from
};

using ProvisionerAction = std::variant<RadioCommand, NodesChanged, StoreMesh, OrderEnded, Notice>;
using ProvisionerActions = ActionQueue<ProvisionerAction>;

}  // namespace slamgw::ble
