// SPDX-License-Identifier: Apache-2.0
// `mesh.json`, version 2:
//
//   {"version": 2, "net_key": KEY, "app_key": KEY, "iv_index": NUMBER, "next_address": "0x0101",
//    "nodes": [{"uuid": UUID, "address": "0x0100", "elements": 1, "name": TEXT or absent,
//               "state": "reserved" | "provisioned" | "configured",
//               "device_key": KEY unless reserved, or null: the radio keeps it,
//               "ttl": NUMBER or absent,
//               "gateway": "0x0001" or absent: what it publishes to, a gateway or their group,
//               "groups": ["0xc002"] with "gateway",
//               "relay_group": "0xc100" or absent: it hears relayed updates there,
//               "changing": true or absent,
//               "refreshed": STEP or absent: the last one that it has taken,
//               "new_address": "0x0105" or absent: it joins again there}],
//    "removed": [{"uuid": UUID, "address": "0x0107", "elements": 1}],
//    "gateways": ["0x0021"] or absent: addresses that other gateways were given,
//    "guest": "0x0021" or absent: this gateway's, given by the one that provisions the mesh,
//    "guest_addresses": 32 with "guest": how many from there are its own, 1 when absent,
//    "host": "room-a" or absent: that one's gateway.id,
//    "life": {"number": 3, "source": "0x0003" or absent, "board": TEXT or absent,
//             "kind": "unknown" | "forgets" | "keeps"} or absent for the first life: the radio's
//             lives so far, the last address that it sends from, what tells it from others,
//    "refresh": {"step": STEP, "net_key": KEY, "app_key": KEY} or absent: the key refresh under
//    way,
//             and the other keys: the new ones, while finishing the old ones}
//
// KEY and UUID are 32 hex digits; STEP is "distributing", "switching" or "finishing". Version 1
// held the two keys only and is still read. Called by MeshFile and for imports.
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
/// Members that this version does not know are ignored; another `version`, addresses or UUIDs that
/// are there twice, and a member that is not what it should be are errors.
Result<NodeDatabase, DecodeError> decode_node_database(std::string_view text);

// An existing network brought in by an operator: the database of Nordic's Python tool
// (interactive_pyaci), of mesh apps that write the same members (Mesh CDB), or another gateway's
// mesh.json. Refusals hold no secrets. Called for `slam-gatewayctl ble import`.

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
