// SPDX-License-Identifier: Apache-2.0
// `mesh.json`, version 2:
//
//   {"version": 2, "net_key": KEY, "app_key": KEY, "iv_index": NUMBER, "next_address": "0x0101",
//    "nodes": [{"uuid": UUID, "address": "0x0100", "elements": 1, "name": TEXT or absent,
//               "state": "reserved" | "provisioned" | "configured",
//               "device_key": KEY unless reserved, "ttl": NUMBER or absent,
//               "gateway": "0x0001" or absent: what it publishes to, a gateway or their group,
//               "groups": ["0xc002"] with "gateway",
//               "changing": true or absent,
//               "new_address": "0x0105" or absent: it joins again there}],
//    "removed": [{"uuid": UUID, "address": "0x0107", "elements": 1}],
//    "gateways": ["0x0021"] or absent: addresses that other gateways were given,
//    "guest": "0x0021" or absent: this gateway's, given by the one that provisions the mesh,
//    "guest_addresses": 32 with "guest": how many from there are its own, 1 when absent,
//    "host": "room-a" or absent: that one's gateway.id,
//    "life": {"number": 3, "source": "0x0003" or absent, "board": TEXT or absent,
//             "kind": "unknown" | "forgets" | "keeps"} or absent for the first life: the boards'
//             lives so far, the last address that one sends from, the last board's UUID}
//
// KEY and UUID are 32 hex digits. Version 1 held the two keys only and is still read. Called by
// MeshFile and for imports.
#pragma once

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

}  // namespace slamgw::ble
