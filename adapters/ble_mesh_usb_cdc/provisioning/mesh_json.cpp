// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <set>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/parse_number.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {

namespace {

using Json = nlohmann::json;
using OrderedJson = nlohmann::ordered_json;

constexpr int hexadecimal = 16;
constexpr std::uint16_t first_group = 0xc000;
constexpr std::uint16_t last_group = 0xfeff;
constexpr std::size_t max_groups = last_group - first_group + 1;

bool parse_address(std::string_view digits, std::uint16_t& out) {
  if (digits.starts_with("0x")) digits.remove_prefix(2);
  const auto address = parse_number<std::uint16_t>(digits, hexadecimal);
  out = address.value_or(out);
  return address.has_value();
}

bool is_group_address(std::uint16_t address) {
  return address >= first_group && address <= last_group;
}

// Readers of members in the JSON files of a mesh. A missing or invalid member yields nothing.

std::optional<std::string> read_text(const Json& json, const char* name) {
  if (!json.is_object()) return std::nullopt;
  const auto member = json.find(name);
  if (member == json.end() || !member->is_string()) return std::nullopt;
  return member->get<std::string>();
}

/// Reads a whole number from 0 to `max`.
std::optional<std::uint32_t> read_count(const Json& json, const char* name, std::uint32_t max) {
  if (!json.is_object()) return std::nullopt;
  const auto member = json.find(name);
  if (member == json.end() || !member->is_number_unsigned()) return std::nullopt;
  const auto value = member->get<std::uint64_t>();
  if (value > max) return std::nullopt;
  return static_cast<std::uint32_t>(value);
}

/// Returns an empty array if the member is missing, and null if it is not an array.
const Json* read_array(const Json& json, const char* name) {
  static const Json empty = Json::array();
  const auto member = json.find(name);
  if (member == json.end()) return &empty;
  return member->is_array() ? &*member : nullptr;
}

/// Reads 32 hex digits, any case; UUIDs also with hyphens.
std::optional<std::array<std::uint8_t, 16>> read_octets(const Json& json, const char* name) {
  const auto digits = read_text(json, name);
  return digits ? parse_uuid(*digits) : std::nullopt;
}

/// Reads a number, or text of up to 4 hex digits with or without 0x; 0x0001-0x7fff.
std::optional<std::uint16_t> read_unicast(const Json& json, const char* name) {
  std::uint16_t address = 0;
  if (const auto text = read_text(json, name)) {
    if (!parse_address(*text, address)) return std::nullopt;
  } else if (const auto number = read_count(json, name, last_unicast_address)) {
    address = static_cast<std::uint16_t>(*number);
  }
  if (address == 0 || address > last_unicast_address) return std::nullopt;
  return address;
}

/// Reads a unicast address as read_unicast() does, or the text of a group address.
std::optional<std::uint16_t> read_destination(const Json& json, const char* name) {
  if (const auto unicast = read_unicast(json, name)) return unicast;
  std::uint16_t group = 0;
  const auto text = read_text(json, name);
  if (!text || !parse_address(*text, group) || !is_group_address(group)) return std::nullopt;
  return group;
}

/// Reads a list of texts with group addresses, each 0xc000-0xfeff.
std::optional<std::vector<std::uint16_t>> read_groups(const Json& json, const char* name) {
  const auto* list = read_array(json, name);
  if (list == nullptr || list->size() > max_groups) return std::nullopt;
  std::vector<std::uint16_t> groups;
  for (const auto& text : *list) {
    std::uint16_t& group = groups.emplace_back();
    if (!text.is_string() || !parse_address(text.get<std::string>(), group)) return std::nullopt;
    if (!is_group_address(group)) return std::nullopt;
  }
  return groups;
}

constexpr std::uint32_t format_version = 2;
constexpr std::uint32_t max_ttl = 127;
constexpr std::uint32_t max_interval_ms = 320;

OrderedJson wishes_json(const NodeWishes& wishes) {
  OrderedJson json = OrderedJson::object();
  if (wishes.ttl) json["ttl"] = *wishes.ttl;
  if (wishes.relay) json["relay"] = *wishes.relay;
  if (wishes.transmit) {
    json["transmit"] = wishes.transmit->sends;
    json["transmit_interval_ms"] = wishes.transmit->interval_ms;
  }
  for (const std::uint16_t group : wishes.groups) json["groups"].push_back(address_text(group));
  for (const auto& [model, address] : wishes.publications)
    json["publications"][model] = address_text(address);
  return json;
}

OrderedJson node_json(const Node& node) {
  OrderedJson json = {{"uuid", to_hex(node.uuid)},
                      {"address", address_text(node.address)},
                      {"elements", node.elements}};
  if (!node.name.empty()) json["name"] = node.name;
  json["state"] = to_string(node.state);
  if (node.state != NodeState::reserved)
    json["device_key"] = node.device_key ? OrderedJson(to_hex(*node.device_key)) : nullptr;
  if (node.new_address != 0) {
    json["new_address"] = address_text(node.new_address);
    json["new_elements"] = node.new_elements;
  }
  if (node.refreshed != RefreshStep::none) json["refreshed"] = to_string(node.refreshed);
  if (node.ttl) json["ttl"] = *node.ttl;
  if (node.wishes != NodeWishes{}) json["wanted"] = wishes_json(node.wishes);
  if (!node.applied) return json;
  json["gateway"] = address_text(node.applied->destination);
  json["groups"] = OrderedJson::array();
  for (const std::uint16_t group : node.applied->groups)
    json["groups"].push_back(address_text(group));
  if (node.applied->relay_group) json["relay_group"] = address_text(*node.applied->relay_group);
  if (node.applied->is_changing) json["changing"] = true;
  return json;
}

OrderedJson life_json(const RadioLife& life) {
  OrderedJson json = {{"number", life.number}};
  if (life.source != 0) json["source"] = address_text(life.source);
  if (!life.radio.empty()) json["board"] = life.radio;
  json["kind"] = to_string(life.kind);
  return json;
}

/// Returns false if `life` is damaged. A file without it predates it: robots heard the gateway.
bool read_life(const Json& json, RadioLife& life) {
  life.number = 1;
  const auto found = json.find("life");
  if (found == json.end()) return true;
  const auto number = read_count(*found, "number", UINT32_MAX);
  const auto kind = read_text(*found, "kind");
  if (!number || !kind) return false;
  life.number = *number;
  life.source = read_unicast(*found, "source").value_or(0);
  life.radio = read_text(*found, "board").value_or("");
  for (const RadioKind each : {RadioKind::forgets, RadioKind::keeps})
    if (*kind == to_string(each)) life.kind = each;
  return true;
}

/// Returns `none` if the step is missing or unknown.
RefreshStep read_step(const Json& json, const char* name) {
  const auto text = read_text(json, name);
  for (const RefreshStep step :
       {RefreshStep::distributing, RefreshStep::switching, RefreshStep::finishing})
    if (text == to_string(step)) return step;
  return RefreshStep::none;
}

/// Returns false if the member is damaged.
bool read_refresh(const Json& json, NodeDatabase& database) {
  const auto found = json.find("refresh");
  if (found == json.end()) return true;
  const RefreshStep step = read_step(*found, "step");
  const auto net_key = read_octets(*found, "net_key");
  const auto app_key = read_octets(*found, "app_key");
  if (step == RefreshStep::none || !net_key || !app_key) return false;
  database.refresh = RefreshState{step, {*net_key, *app_key}};
  return true;
}

std::optional<NodeState> read_state(const Json& json) {
  const auto text = read_text(json, "state");
  for (const NodeState state : {NodeState::reserved, NodeState::provisioned, NodeState::configured})
    if (text == to_string(state)) return state;
  return std::nullopt;
}

/// Returns false if the settings are damaged. Without them the node is left as it is.
bool read_applied(const Json& json, Node& node) {
  if (const auto ttl = read_count(json, "ttl", max_ttl)) node.ttl = static_cast<std::uint8_t>(*ttl);
  if (!json.contains("gateway") || !json.contains("groups")) return true;
  const auto destination = read_destination(json, "gateway");
  auto groups = read_groups(json, "groups");
  if (!destination || !groups) return false;
  node.applied =
      AppliedSettings{*destination, std::move(*groups), json.value("changing", Json()) == true};
  if (!json.contains("relay_group")) return true;
  const auto relay_group = read_destination(json, "relay_group");
  if (!relay_group || !is_group_address(*relay_group)) return false;
  node.applied->relay_group = relay_group;
  return true;
}

/// Returns false if the member is damaged.
bool read_wishes(const Json& node, NodeWishes& wishes) {
  const auto found = node.find("wanted");
  if (found == node.end()) return true;
  if (!found->is_object()) return false;
  if (const auto ttl = read_count(*found, "ttl", max_ttl))
    wishes.ttl = static_cast<std::uint8_t>(*ttl);
  if (const auto relay = found->find("relay"); relay != found->end() && relay->is_boolean())
    wishes.relay = relay->get<bool>();
  const auto groups = read_groups(*found, "groups");
  if (!groups || groups->size() > NodeWishes::max_groups) return false;
  wishes.groups = *groups;
  const Json publications = found->value("publications", Json::object());
  for (const ModelId& model : publishers)
    if (const auto address = read_destination(publications, to_string(model).c_str()))
      wishes.publications[to_string(model)] = *address;
  const auto sends = read_count(*found, "transmit", max_ttl);
  const auto interval_ms = read_count(*found, "transmit_interval_ms", max_interval_ms);
  if (sends && interval_ms && Transmissions::is_valid(*sends, *interval_ms))
    wishes.transmit =
        Transmissions{static_cast<std::uint8_t>(*sends), static_cast<std::uint16_t>(*interval_ms)};
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
  Node node{.uuid = *uuid,
            .address = *address,
            .elements = static_cast<std::uint8_t>(*elements),
            .state = *state};
  node.new_address = new_address.value_or(0);
  if (new_address) {  // an older file has one count for both addresses
    const auto count = read_count(json, "new_elements", max_elements).value_or(*elements);
    node.new_elements = static_cast<std::uint8_t>(std::max(count, 1U));
  }
  node.refreshed = read_step(json, "refreshed");
  node.name = read_text(json, "name").value_or("");
  if (!is_valid_level(node.name)) node.name.clear();  // the node gets its default name
  node.device_key = read_octets(json, "device_key");
  const bool has_radio_key = json.contains("device_key") && json["device_key"].is_null();
  if (!node.device_key && !has_radio_key && node.state != NodeState::reserved) return std::nullopt;
  if (!read_applied(json, node) || !read_wishes(json, node.wishes)) return std::nullopt;
  return node;
}

bool read_nodes(const Json& json, NodeDatabase& database) {
  const auto* nodes = read_array(json, "nodes");
  if (nodes == nullptr || nodes->size() > NodeDatabase::max_nodes) return false;
  for (const auto& member : *nodes) {
    const auto node = read_node(member);
    if (!node || database.find(node->uuid) ||
        !is_address_free(database, node->address, node->elements, {}, node->uuid) ||
        !is_address_free(database, node->joining_address(), node->joining_elements(), {},
                         node->uuid))
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

/// Returns false if the member is damaged.
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
  if (const auto& refresh = database.refresh)
    json["refresh"] = {{"step", to_string(refresh->step)},
                       {"net_key", to_hex(refresh->other.net_key)},
                       {"app_key", to_hex(refresh->other.app_key)}};
  return json.dump(2) + "\n";
}

Result<NodeDatabase, DecodeError> decode_node_database(std::string_view text) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return DecodeError::bad_value;
  const auto version = read_count(json, "version", format_version);
  const auto net_key = read_octets(json, "net_key");
  const auto app_key = read_octets(json, "app_key");
  if (version != format_version || !net_key || !app_key) return DecodeError::bad_value;
  NodeDatabase database;
  database.keys = {*net_key, *app_key};
  if (!read_life(json, database.life)) return DecodeError::bad_value;
  const auto iv_index = read_count(json, "iv_index", UINT32_MAX);
  const auto next_address = read_text(json, "next_address");
  if (!iv_index || !next_address || !read_nodes(json, database) || !read_removed(json, database) ||
      !read_gateways(json, database) || !read_refresh(json, database))
    return DecodeError::bad_value;
  database.iv_index = *iv_index;
  // The number is one past the last address when all were handed out.
  if (*next_address == address_text(last_unicast_address + 1)) {
    database.next_address = last_unicast_address + 1;
  } else {
    const auto address = read_unicast(json, "next_address");
    if (!address) return DecodeError::bad_value;
    database.next_address = *address;
  }
  return database;
}

namespace {

/// Returns the key with index 0 in a list of `{"index", "key"}`.
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
  Node node{.uuid = *uuid, .address = *address, .elements = static_cast<std::uint8_t>(count)};
  node.device_key = device_key;
  node.state = is_configured(json) ? NodeState::configured : NodeState::provisioned;
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
  database.life.number = 1;  // the tool's own radio
  database.iv_index = read_count(json, "ivIndex", UINT32_MAX).value_or(0);
  const auto* nodes = read_array(json, "nodes");
  if (nodes == nullptr || nodes->size() > NodeDatabase::max_nodes)
    return Refusal{
        fmt::format("`nodes` must be a list with at most {} entries", NodeDatabase::max_nodes)};
  for (std::size_t i = 0; i < nodes->size(); ++i) {
    auto node = (*nodes)[i].is_object() ? read_imported_node((*nodes)[i]) : std::nullopt;
    if (!node)
      return Refusal{fmt::format("nodes[{}] lacks a UUID, a deviceKey or a unicastAddress", i)};
    // The robots' names must differ, unlike those in the tool.
    if (std::ranges::find(database.nodes, node->name, &Node::name) != database.nodes.end())
      node->name.clear();
    database.nodes.push_back(std::move(*node));
  }
  return database;
}

}  // namespace

Result<NodeDatabase, Refusal> decode_imported_mesh(std::string_view text) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return Refusal{"it is not a JSON object"};
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
  database.gateways.clear();  // only the exporting gateway needs them
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
    return imported;  // the other gateway knows all nodes
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
    const std::array places{std::pair(node.address, node.elements),
                            std::pair(node.joining_address(), node.joining_elements())};
    for (const auto& [address, elements] : places) {
      if (!is_address_free(merged, address, elements, gateway, node.uuid))
        return Refusal{
            fmt::format("the address 0x{:04x} of node {} is another node's or the gateway's own "
                        "(ble_mesh.address)",
                        address, to_hex(node.uuid))};
      const std::uint32_t end = address + elements;
      if (end > merged.next_address) merged.next_address = static_cast<std::uint16_t>(end);
    }
    merged.nodes.push_back(node);
  }
  if (merged.nodes.size() > NodeDatabase::max_nodes)
    return Refusal{fmt::format("more than {} nodes", NodeDatabase::max_nodes)};
  return merged;
}

}  // namespace slamgw::ble
