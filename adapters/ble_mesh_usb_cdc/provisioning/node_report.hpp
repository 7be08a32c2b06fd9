// SPDX-License-Identifier: Apache-2.0
// What a node has said about itself, as operators see it: `slam-gatewayctl ping` and `ble config`.
// Pure.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"

namespace slamgw::ble {

/// `{"robot", "mesh", "answered", "after_ms", "copies", "ttl", "hops", "rssi_dbm", "why"}`. `ttl`
/// on arrival, `hops`: relays on the way.
std::string ping_json(const std::string& robot, const NodeConfiguration& ping);

/// Whether messages to this address come to the gateway.
using Hears = std::function<bool(std::uint16_t)>;

/// `{"robot", "uuid", "address", "ttl", "relay", "transmit", "models": [...], "wanted",
/// "warnings": [...], "problem"}`: what the node has, then what an operator wants of it.
std::string node_config_json(const std::string& robot, const Node& node,
                             const NodeConfiguration& inquiry, const Hears& hears);

/// The model of `publishers` that has this id, or this name with or without " client" or " server".
std::optional<ModelId> find_publisher(std::string_view name);

}  // namespace slamgw::ble
