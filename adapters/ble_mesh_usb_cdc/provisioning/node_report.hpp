// SPDX-License-Identifier: Apache-2.0
// A node's answers about itself, as operators see them: `slam-gatewayctl ping` and `ble config`.
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

/// Returns true if messages to this address come to the gateway.
using Hears = std::function<bool(std::uint16_t)>;

/// `{"robot", "uuid", "address", "ttl", "relay", "transmit", "models": [...], "wanted", "warnings":
/// [...], "problem"}`: the node's values, then those that an operator wants.
std::string node_config_json(const std::string& robot, const Node& node,
                             const NodeConfiguration& inquiry, const Hears& hears);

/// Returns the model of `publishers` with this id, or with this name, whose " client" or " server"
/// may be missing.
std::optional<ModelId> find_publisher(std::string_view name);

}  // namespace slamgw::ble
