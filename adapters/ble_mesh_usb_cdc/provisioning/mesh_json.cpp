// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "adapters/ble_mesh_usb_cdc/nordic/address_book.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/address_plan.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/json_fields.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {
namespace {

using Json = nlohmann::json;
using OrderedJson = nlohmann::ordered_json;

constexpr std::uint32_t keys_only_version = 1;
constexpr std::uint32_t format_version = 2;
constexpr std::uint32_t max_ttl = 127;

std::string address_text(std::uint16_t address) { return fmt::format("0x{:04x}", address); }

OrderedJson node_json(const Node& node) {
  OrderedJson json = {{"uuid", to_hex(node.uuid)},
                      {"address", address_text(node.address)},
                      {"elements", node.elements}};
  if (!node.name.empty()) json["name"] = node.name;
  json["state"] = to_string(node.state);
  if (node.state != NodeState::reserved) json["device_key"] = to_hex(node.device_key);
  if (node.new_address != 0) json["new_address"] = address_text(node.new_address);
  if (node.ttl) json["ttl"] = *node.ttl;
  if (!node.applied) return json;
  json["gateway"] = address_text(node.applied->destination);
  json["groups"] = OrderedJson::array();
  for (const std::uint16_t group : node.applied->groups)
    json["groups"].push_back(address_text(group));
  if (node.applied->is_changing) json["changing"] = true;
  return json;
}

OrderedJson life_json(const BoardLife& life) {
  OrderedJson json = {{"number", life.number}};
  if (life.source != 0) json["source"] = address_text(life.source);
  if (!life.board.empty()) json["board"] = life.board;
  json["kind"] = to_string(life.kind);
  return json;
}

/// False when it is damaged. A file without it predates it: robots have heard the gateway.
bool read_life(const Json& json, BoardLife& life) {
  life.number = 1;
  const auto found = json.find("life");
  if (found == json.end()) return true;
  const auto number = read_count(*found, "number", UINT32_MAX);
  const auto kind = read_text(*found, "kind");
  if (!number || !kind) return false;
  life.number = *number;
  life.source = read_unicast(*found, "source").value_or(0);
  life.board = read_text(*found, "board").value_or("");
  for (const BoardKind each : {BoardKind::forgets, BoardKind::keeps})
    if (*kind == to_string(each)) life.kind = each;
  return true;
}

std::optional<NodeState> read_state(const Json& json) {
  const auto text = read_text(json, "state");
  for (const NodeState state : {NodeState::reserved, NodeState::provisioned, NodeState::configured})
    if (text == to_string(state)) return state;
  return std::nullopt;
}

/// False when it is damaged; without it the node stays as it is.
bool read_applied(const Json& json, Node& node) {
  if (const auto ttl = read_count(json, "ttl", max_ttl)) node.ttl = static_cast<std::uint8_t>(*ttl);
  if (!json.contains("gateway") || !json.contains("groups")) return true;
  const auto destination = read_destination(json, "gateway");
  auto groups = read_groups(json, "groups");
  if (!destination || !groups) return false;
  node.applied =
      AppliedSettings{*destination, std::move(*groups), json.value("changing", Json()) == true};
  return true;
}

std::optional<Node> read_node(const Json& json) {
  const auto uuid = read_octets(json, "uuid");
  const auto address = read_unicast(json, "address");
  const auto elements = read_count(json, "elements", max_elements);
  const auto state = read_state(json);
  const auto new_address = read_unicast(json, "new_address");
  if (!uuid || !address || !elements || *elements == 0 || !state) return std::nullopt;
  if (json.contains("new_address") && !new_address) return std::nullopt;
  Node node{*uuid, *address, static_cast<std::uint8_t>(*elements), *state, {}, {}, {}, {}, 0};
  node.new_address = new_address.value_or(0);
  node.name = read_text(json, "name").value_or("");
  if (!is_valid_level(node.name)) node.name.clear();  // goes by its default name
  const auto device_key = read_octets(json, "device_key");
  if (!device_key && node.state != NodeState::reserved) return std::nullopt;
  node.device_key = device_key.value_or(Key{});
  if (!read_applied(json, node)) return std::nullopt;
  return node;
}

bool read_nodes(const Json& json, NodeDatabase& database) {
  const auto* nodes = read_array(json, "nodes");
  if (nodes == nullptr || nodes->size() > NodeDatabase::max_nodes) return false;
  for (const auto& member : *nodes) {
    const auto node = read_node(member);
    if (!node || database.find(node->uuid) ||
        !is_address_free(database, node->address, node->elements, {}, node->uuid) ||
        !is_address_free(database, node->joining_address(), node->elements, {}, node->uuid))
      return false;
    database.nodes.push_back(*node);
  }
  return true;
}

bool read_removed(const Json& json, NodeDatabase& database) {
  const auto* removed = read_array(json, "removed");
  if (removed == nullptr || removed->size() > NodeDatabase::max_removed) return false;
  for (const auto& member : *removed) {
    const auto uuid = read_octets(member, "uuid");
    const auto address = read_unicast(member, "address");
    const auto elements = read_count(member, "elements", max_elements);
    if (!uuid || !address || !elements) return false;
    database.removed.push_back({*uuid, *address, static_cast<std::uint8_t>(*elements)});
  }
  return true;
}

/// False when it is damaged.
bool read_gateways(const Json& json, NodeDatabase& database) {
  if (json.contains("guest")) {
    database.guest_address = read_unicast(json, "guest");
    if (!database.guest_address) return false;
    const auto addresses = read_count(json, "guest_addresses", max_sources);
    database.guest_addresses = static_cast<std::uint16_t>(std::max(addresses.value_or(1), 1U));
    database.host = read_text(json, "host").value_or("");
    if (!is_valid_level(database.host)) database.host.clear();
  }
  if (!json.contains("gateways")) return true;
  const auto* gateways = read_array(json, "gateways");
  if (gateways == nullptr || gateways->size() > first_robot_address) return false;
  for (const auto& member : *gateways) {
    const auto address = read_unicast(Json{{"address", member}}, "address");
    if (!address) return false;
    database.gateways.push_back(*address);
  }
  return true;
}

}  // namespace

std::string encode_node_database(const NodeDatabase& database) {
  OrderedJson json = {{"version", format_version},
                      {"net_key", to_hex(database.keys.net_key)},
                      {"app_key", to_hex(database.keys.app_key)},
                      {"iv_index", database.iv_index},
                      {"next_address", address_text(database.next_address)},
                      {"nodes", OrderedJson::array()},
                      {"removed", OrderedJson::array()}};
  for (const Node& node : database.nodes) json["nodes"].push_back(node_json(node));
  for (const RemovedNode& node : database.removed) {
    json["removed"].push_back({{"uuid", to_hex(node.uuid)},
                               {"address", address_text(node.address)},
                               {"elements", node.elements}});
  }
  for (const std::uint16_t address : database.gateways)
    json["gateways"].push_back(address_text(address));
  if (database.guest_address) {
    json["guest"] = address_text(*database.guest_address);
    json["guest_addresses"] = database.guest_addresses;
  }
  if (!database.host.empty()) json["host"] = database.host;
  json["life"] = life_json(database.life);
  return json.dump(2) + "\n";
}

Result<NodeDatabase, DecodeError> decode_node_database(std::string_view text) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return DecodeError::bad_value;
  const auto version = read_count(json, "version", format_version);
  const auto net_key = read_octets(json, "net_key");
  const auto app_key = read_octets(json, "app_key");
  if (!version || *version < keys_only_version || !net_key || !app_key)
    return DecodeError::bad_value;
  NodeDatabase database;
  database.keys = {*net_key, *app_key};
  if (!read_life(json, database.life)) return DecodeError::bad_value;
  if (*version == keys_only_version) return database;
  const auto iv_index = read_count(json, "iv_index", UINT32_MAX);
  const auto next_address = read_text(json, "next_address");
  if (!iv_index || !next_address || !read_nodes(json, database) || !read_removed(json, database) ||
      !read_gateways(json, database))
    return DecodeError::bad_value;
  database.iv_index = *iv_index;
  // One past the last address when all were handed out.
  if (*next_address == address_text(last_unicast_address + 1)) {
    database.next_address = last_unicast_address + 1;
  } else {
    const auto address = read_unicast(json, "next_address");
    if (!address) return DecodeError::bad_value;
    database.next_address = *address;
  }
  return database;
}

}  // namespace slamgw::ble
