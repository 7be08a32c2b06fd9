// SPDX-License-Identifier: Apache-2.0
// What a node has said about itself, as operators see it: `slam-gatewayctl ping` and `ble config`.
// Pure.
#pragma once

#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"

namespace slamgw::ble {

/// `{"robot", "mesh", "answered", "after_ms", "copies", "ttl", "hops", "rssi_dbm", "why"}`. `ttl`
/// on arrival, `hops`: relays on the way.
std::string ping_json(const std::string& robot, const NodeConfiguration& ping);

/// `{"robot", "uuid", "address", "ttl", "relay", "transmit", "models": [...], "wanted",
/// "problem"}`: what the node has, then what an operator wants of it.
std::string node_config_json(const std::string& robot, const Node& node,
                             const NodeConfiguration& inquiry);

}  // namespace slamgw::ble
