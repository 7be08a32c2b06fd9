// SPDX-License-Identifier: Apache-2.0
// What Provisioner, and the parts that it is made of, ask of BleMesh, and know of the serial board.
#pragma once

#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

/// To the board; answered by on_command_ended unless the link goes down.
struct BoardCommand {
  Bytes frame;
};
struct SendUnderDeviceKey {
  std::uint16_t address = 0;
  std::uint16_t devkey_handle = 0;
  Bytes access;
};
/// Nodes, or their names, are different from before.
struct NodesChanged {};
/// The mesh has other keys than the board was started up with.
struct UseKeys {
  MeshKeys keys;
};
/// Answered by on_board_cleared.
struct ClearBoard {};
/// It comes back without its replay list.
struct RestartBoard {};
/// The board sends from this address; the disk has it.
struct UseSource {
  std::uint16_t source = 0;
  std::uint16_t count = 1;  ///< of the addresses for a board without one
};
/// The disk does not have it yet.
struct DelaySource {
  std::string why;
};

struct BoardState {
  bool is_up = false;
  std::string down_reason = "not started";
  std::uint16_t subnet_handle = 0;                 ///< as the board named it when it came up last
  SerialVersion version = SerialVersion::sdk_3_1;  ///< of its firmware
  std::uint16_t source = 0;                        ///< the address that it sends from
};

using ProvisionerAction =
    std::variant<BoardCommand, SendUnderDeviceKey, NodesChanged, UseKeys, ClearBoard, RestartBoard,
                 UseSource, DelaySource, StoreMesh, OrderEnded, Notice>;
using ProvisionerActions = ActionQueue<ProvisionerAction>;

}  // namespace slamgw::ble
