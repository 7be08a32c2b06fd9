// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/imported_mesh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "adapters/ble_mesh_usb_cdc/provisioning/address_plan.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/json_fields.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {
namespace {

using Json = nlohmann::json;

/// The key with index 0 in a list of `{"index", "key"}`.
std::optional<Key> read_key_0(const Json& json, const char* list) {
  const auto* keys = read_array(json, list);
  if (keys == nullptr) return std::nullopt;
  for (const auto& key : *keys)
    if (read_count(key, "index", 0)) return read_octets(key, "key");
  return std::nullopt;
}

bool is_configured(const Json& node) {
  const auto complete = node.find("configComplete");
  if (complete != node.end() && complete->is_boolean() && complete->get<bool>()) return true;
  const auto* app_keys = read_array(node, "appKeys");
  return app_keys != nullptr && !app_keys->empty();
}

std::optional<Node> read_imported_node(const Json& json) {
  const auto uuid = read_octets(json, "UUID");
  const auto device_key = read_octets(json, "deviceKey");
  const auto address = read_unicast(json, "unicastAddress");
  if (!uuid || !device_key || !address) return std::nullopt;
  const auto* elements = read_array(json, "elements");
  const std::size_t count = elements == nullptr ? 1 : std::max<std::size_t>(elements->size(), 1);
  if (count > max_elements) return std::nullopt;
  Node node{*uuid,
            *address,
            static_cast<std::uint8_t>(count),
            NodeState::provisioned,
            *device_key,
            {},
            {},
            {},
            0};
  if (is_configured(json)) node.state = NodeState::configured;
  const auto name = read_text(json, "name");
  if (name && is_valid_level(*name)) node.name = *name;
  return node;
}

Result<NodeDatabase, Refusal> decode_tool_database(const Json& json) {
  const auto net_key = read_key_0(json, "netKeys");
  const auto app_key = read_key_0(json, "appKeys");
  if (!net_key || !app_key)
    return Refusal{"it has no network key 0 (netKeys) or no application key 0 (appKeys)"};
  NodeDatabase database;
  database.keys = {*net_key, *app_key};
  database.life.number = 1;  // the tool's own board
  database.iv_index = read_count(json, "ivIndex", UINT32_MAX).value_or(0);
  const auto* nodes = read_array(json, "nodes");
  if (nodes == nullptr || nodes->size() > NodeDatabase::max_nodes)
    return Refusal{fmt::format("nodes is no list of at most {}", NodeDatabase::max_nodes)};
  for (std::size_t i = 0; i < nodes->size(); ++i) {
    auto node = (*nodes)[i].is_object() ? read_imported_node((*nodes)[i]) : std::nullopt;
    if (!node)
      return Refusal{fmt::format("nodes[{}] lacks a UUID, a deviceKey or a unicastAddress", i)};
    // The robots' names must differ; the tool's need not.
    if (std::ranges::find(database.nodes, node->name, &Node::name) != database.nodes.end())
      node->name.clear();
    database.nodes.push_back(std::move(*node));
  }
  return database;
}

}  // namespace

Result<NodeDatabase, Refusal> decode_imported_mesh(std::string_view text) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return Refusal{"it is no JSON object"};
  if (json.contains("netKeys")) return decode_tool_database(json);
  const auto database = decode_node_database(text);
  if (!database.has_value())
    return Refusal{
        "it is neither a mesh database (netKeys, appKeys, nodes) nor a mesh.json of this program"};
  return *database;
}

std::string exported_mesh_json(NodeDatabase database, std::uint16_t address,
                               std::uint16_t addresses, const std::string& host) {
  database.guest_address = address;
  database.guest_addresses = addresses;
  database.life = {};
  database.host = host;
  database.gateways.clear();  // known to the one that hands them out
  return nlohmann::ordered_json{{"address", fmt::format("0x{:04x}", address)},
                                {"mesh", encode_node_database(database)}}
      .dump();
}

Result<NodeDatabase, Refusal> merge_imported_mesh(const std::optional<NodeDatabase>& own,
                                                  NodeDatabase imported,
                                                  std::uint16_t gateway_address) {
  if (own && own->keys != imported.keys)
    return Refusal{
        "this gateway has another mesh already, and robots have its keys: move its mesh.json away "
        "first (and clear the serial board: ble reset-board), then import again"};
  if (imported.guest_address && own && !own->guest_address)
    return Refusal{"this gateway provisions this mesh itself; the file is for another one"};
  if (imported.guest_address && *imported.guest_address != gateway_address)
    return Refusal{
        fmt::format("it was exported for a gateway whose ble_mesh.address is 0x{:04x}: set that, "
                    "restart slam-gateway and import it again",
                    *imported.guest_address)};
  if (imported.guest_address) {
    if (own) imported.iv_index = std::max(own->iv_index, imported.iv_index);
    if (own) imported.life = own->life;
    return imported;  // all that the other gateway knows
  }
  NodeDatabase merged = own.value_or(imported);
  if (!own) merged.nodes.clear();
  merged.iv_index = std::max(merged.iv_index, imported.iv_index);
  std::set<std::uint16_t> gateway{gateway_address};
  for (std::uint16_t used = gateway_address; used < merged.life.source;) gateway.insert(++used);
  for (const Node& node : imported.nodes) {
    if (Node* known = merged.find(node.uuid)) {
      if (known->state != NodeState::reserved) continue;
      std::erase_if(merged.nodes, [&](const Node& other) { return other.uuid == node.uuid; });
    }
    if (!is_address_free(merged, node.address, node.elements, gateway, node.uuid))
      return Refusal{
          fmt::format("the address 0x{:04x} of node {} is another node's or the gateway's own "
                      "(ble_mesh.address)",
                      node.address, to_hex(node.uuid))};
    merged.nodes.push_back(node);
    const std::uint32_t end = node.address + node.elements;
    if (end > merged.next_address) merged.next_address = static_cast<std::uint16_t>(end);
  }
  if (merged.nodes.size() > NodeDatabase::max_nodes)
    return Refusal{fmt::format("more than {} nodes", NodeDatabase::max_nodes)};
  return merged;
}

}  // namespace slamgw::ble
