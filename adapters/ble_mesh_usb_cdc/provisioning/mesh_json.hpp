// SPDX-License-Identifier: Apache-2.0
// `mesh.json`, version 2:
//
//   {"version": 2, "net_key": KEY, "app_key": KEY, "iv_index": NUMBER, "next_address": "0x0101",
//    "nodes": [{"uuid": UUID, "address": "0x0100", "elements": 1, "name": TEXT or absent,
//               "state": "reserved" | "provisioned" | "configured",
//               "device_key": KEY unless reserved, or null: the radio keeps it,
//               "ttl": NUMBER or absent,
//               "gateway": "0x0001" or absent: where it publishes, to a gateway or their group,
//               "groups": ["0xc002"] with "gateway",
//               "relay_group": "0xc100" or absent: the group in which it hears relayed updates,
//               "changing": true or absent,
//               "refreshed": STEP or absent: the last step that it has taken,
//               "wanted": OBJECT or absent: what an operator has set for it (NodeWishes),
//               "new_address": "0x0105" or absent: where it joins again,
//               "new_elements": 1 or absent: how many it has there}],
//    "removed": [{"uuid": UUID, "address": "0x0107", "elements": 1}],
//    "gateways": ["0x0021"] or absent: addresses that other gateways got from this one,
//    "guest": "0x0021" or absent: this gateway's address, if another one provisions the mesh,
//    "guest_addresses": 32 with "guest": number of this gateway's addresses, 1 when absent,
//    "host": "room-a" or absent: gateway.id of the gateway that provisions the mesh,
//    "life": {"number": 3, "source": "0x0003" or absent, "board": TEXT or absent,
//             "kind": "unknown" | "forgets" | "keeps"} or absent for the first life: the radio's
//             lives so far, the last address that it sent from, the radio's identity,
//    "refresh": {"step": STEP, "net_key": KEY, "app_key": KEY} or absent: the key refresh,
//             and the other keys: the new keys; while finishing, the old keys}
//
// KEY and UUID are 32 hex digits; STEP is "distributing", "switching" or "finishing". Called by
// MeshFile and for imports.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

std::string encode_node_database(const NodeDatabase& database);
/// Ignores members that this version does not know. Another `version`, duplicate addresses or
/// UUIDs, and invalid members are errors.
Result<NodeDatabase, DecodeError> decode_node_database(std::string_view text);

// Imports an existing network for `slam-gatewayctl ble import`. The file is the database of
// Nordic's Python tool (interactive_pyaci), that of a mesh app that writes the same members (Mesh
// CDB), or another gateway's mesh.json. Refusals hold no secrets.

/// Network key 0 and application key 0 become the mesh's. Nodes that have an application key count
/// as configured and are left as they are.
Result<NodeDatabase, Refusal> decode_imported_mesh(std::string_view text);

/// Returns the answer to ExportOrder: the mesh for another gateway, which has `addresses` unicast
/// addresses from `address` up. `host` is this gateway's `gateway.id`. The answer holds keys.
std::string exported_mesh_json(NodeDatabase database, std::uint16_t address,
                               std::uint16_t addresses, const std::string& host);

/// Returns the imported mesh merged with `own`, the present mesh if there is one. Refuses another
/// network, and addresses that two nodes or a node and the gateway share. Also refuses a mesh that
/// was exported for a gateway with another address.
Result<NodeDatabase, Refusal> merge_imported_mesh(const std::optional<NodeDatabase>& own,
                                                  NodeDatabase imported,
                                                  std::uint16_t gateway_address);

}  // namespace slamgw::ble
