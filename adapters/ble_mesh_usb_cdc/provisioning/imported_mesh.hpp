// SPDX-License-Identifier: Apache-2.0
// An existing network brought in by an operator: the database of Nordic's Python tool
// (interactive_pyaci), of mesh apps that write the same members (Mesh CDB), or another gateway's
// mesh.json. Refusals hold no secrets. Called for `slam-gatewayctl ble import`.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// Network key 0 and application key 0 become the mesh's. Nodes that have an application key count
/// as configured and are left as they are.
Result<NodeDatabase, Refusal> decode_imported_mesh(std::string_view text);

/// For ExportOrder: the mesh as another gateway needs it, which has `addresses` unicast addresses
/// from `address` up. `host`: the `gateway.id` of this one. Holds keys.
std::string exported_mesh_json(NodeDatabase database, std::uint16_t address,
                               std::uint16_t addresses, const std::string& host);

/// The imported mesh, with what is known already: `own` is the mesh that there is, if any. Another
/// network than that, and addresses that two nodes or a node and the gateway share, are refused,
/// and so is what was exported for a gateway with another address.
Result<NodeDatabase, Refusal> merge_imported_mesh(const std::optional<NodeDatabase>& own,
                                                  NodeDatabase imported,
                                                  std::uint16_t gateway_address);

}  // namespace slamgw::ble
