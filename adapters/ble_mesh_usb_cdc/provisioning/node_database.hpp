// SPDX-License-Identifier: Apache-2.0
// What the gateway must not lose about its BLE mesh: its keys. Kept as JSON in `mesh.json` in the
// store directory. Pure; mesh_file.hpp reads and writes the file. Never logged.
#pragma once

#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/decode_error.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic_serial/commands.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

struct NodeDatabase {
  MeshKeys keys;
};

/// `{"version": 1, "net_key": "<32 hex digits>", "app_key": "<32 hex digits>"}`
std::string encode_node_database(const NodeDatabase& database);
/// Members that this version does not know are ignored; another `version` is an error.
Result<NodeDatabase, DecodeError> decode_node_database(std::string_view text);

}  // namespace slamgw::ble
