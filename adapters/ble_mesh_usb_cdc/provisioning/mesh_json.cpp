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

constexpr std::uint32_t format_version = 2;
constexpr std::uint8_t max_ttl = 127;
constexpr std::uint16_t max_interval_ms = 320;

// Readers of the JSON files of a mesh. A missing or invalid value yields nothing.

/// Returns null if the member is missing, or if `json` is not an object.
const Json& member(const Json& json, const char* name) {
  static const Json missing;
  const auto found = json.find(name);
  return found == json.end() ? missing : *found;
}

std::optional<std::string> read_text(const Json& json, const char* name) {
  const Json& value = member(json, name);
  return value.is_string() ? std::optional(value.get<std::string>()) : std::nullopt;
}

/// Reads a name of a robot or a gateway; empty if it is missing or invalid.
std::string read_name(const Json& json, const char* name) {
  const auto text = read_text(json, name);
  return text && is_valid_level(*text) ? *text : std::string();
}

/// Reads a whole number from 0 to `max`.
template <class Number>
std::optional<Number> read_count(const Json& json, const char* name, Number max) {
  const Json& value = member(json, name);
  if (!value.is_number_unsigned() || value.get<std::uint64_t>() > max) return std::nullopt;
  return value.get<Number>();
}

/// Reads the text of one of these values.
template <class Value>
std::optional<Value> read_one_of(const Json& json, const char* name,
                                 std::initializer_list<Value> values) {
  const auto text = read_text(json, name);
  for (const Value value : values)
    if (text == to_string(value)) return value;
  return std::nullopt;
}

/// Calls `read` for each entry of a list, which may be missing. Returns false if the member is not
/// a list of at most `max` entries, or if `read` does.
bool read_list(const Json& json, const char* name, std::size_t max, const auto& read) {
  const auto list = json.find(name);
  if (list == json.end()) return true;
  return list->is_array() && list->size() <= max && std::ranges::all_of(*list, read);
}

/// Reads 32 hex digits, any case; UUIDs also with hyphens.
std::optional<std::array<std::uint8_t, 16>> read_octets(const Json& json, const char* name) {
  const auto digits = read_text(json, name);
  return digits ? parse_uuid(*digits) : std::nullopt;
}

/// Reads up to 4 hex digits with or without 0x.
std::optional<std::uint16_t> address_of(const Json& text) {
  if (!text.is_string()) return std::nullopt;
  const auto written = text.get<std::string>();
  std::string_view digits = written;
  if (digits.starts_with("0x")) digits.remove_prefix(2);
  return parse_number<std::uint16_t>(digits, hexadecimal);
}

/// Reads a group address, 0xc000-0xfeff.
std::optional<std::uint16_t> group_of(const Json& text) {
  const auto address = address_of(text);
  return address >= first_group && address <= last_group ? address : std::nullopt;
}

/// Reads a number, or text as address_of() does; 0x0001-0x7fff.
std::optional<std::uint16_t> unicast_of(const Json& value) {
  auto address = address_of(value);
  if (value.is_number_unsigned() && value.get<std::uint64_t>() <= last_unicast_address)
    address = value.get<std::uint16_t>();
  return address > 0 && address <= last_unicast_address ? address : std::nullopt;
}

std::optional<std::uint16_t> read_unicast(const Json& json, const char* name) {
  return unicast_of(member(json, name));
}

/// Reads a unicast address, or a group address.
std::optional<std::uint16_t> read_destination(const Json& json, const char* name) {
  const auto unicast = read_unicast(json, name);
  return unicast ? unicast : group_of(member(json, name));
}

std::optional<std::vector<std::uint16_t>> read_groups(const Json& json, const char* name) {
  std::vector<std::uint16_t> groups;
  const bool is_read = read_list(json, name, max_groups, [&](const Json& text) {
    const auto group = group_of(text);
    if (group) groups.push_back(*group);
    return group.has_value();
  });
  return is_read ? std::optional(std::move(groups)) : std::nullopt;
}

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
  if (!number || !read_text(*found, "kind")) return false;
  life.number = *number;
  life.source = read_unicast(*found, "source").value_or(0);
  life.radio = read_text(*found, "board").value_or("");
  life.kind = read_one_of(*found, "kind", {RadioKind::forgets, RadioKind::keeps})
                  .value_or(RadioKind::unknown);
  return true;
}

/// Returns `none` if the step is missing or unknown.
RefreshStep read_step(const Json& json, const char* name) {
  return read_one_of(json, name,
                     {RefreshStep::distributing, RefreshStep::switching, RefreshStep::finishing})
      .value_or(RefreshStep::none);
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

/// Returns false if the settings are damaged. Without them the node is left as it is.
bool read_applied(const Json& json, Node& node) {
  node.ttl = read_count(json, "ttl", max_ttl);
  if (!json.contains("gateway") || !json.contains("groups")) return true;
  const auto destination = read_destination(json, "gateway");
  auto groups = read_groups(json, "groups");
  if (!destination || !groups) return false;
  node.applied =
      AppliedSettings{*destination, std::move(*groups), member(json, "changing") == true};
  node.applied->relay_group = group_of(member(json, "relay_group"));
  return node.applied->relay_group || !json.contains("relay_group");
}

/// Returns false if the member is damaged.
bool read_wishes(const Json& node, NodeWishes& wishes) {
  const auto found = node.find("wanted");
  if (found == node.end()) return true;
  if (!found->is_object()) return false;
  wishes.ttl = read_count(*found, "ttl", max_ttl);
  if (const Json& relay = member(*found, "relay"); relay.is_boolean())
    wishes.relay = relay.get<bool>();
  const auto groups = read_groups(*found, "groups");
  if (!groups || groups->size() > NodeWishes::max_groups) return false;
  wishes.groups = *groups;
  const Json& publications = member(*found, "publications");
  for (const ModelId& model : publishers)
    if (const auto address = read_destination(publications, to_string(model).c_str()))
      wishes.publications[to_string(model)] = *address;
  const auto sends = read_count(*found, "transmit", max_ttl);
  const auto interval_ms = read_count(*found, "transmit_interval_ms", max_interval_ms);
  if (sends && interval_ms && Transmissions::is_valid(*sends, *interval_ms))
    wishes.transmit = Transmissions{*sends, *interval_ms};
  return true;
}

std::optional<Node> read_node(const Json& json) {
  const auto uuid = read_octets(json, "uuid");
  const auto address = read_unicast(json, "address");
  const auto elements = read_count(json, "elements", max_elements);
  const auto state = read_one_of(
      json, "state", {NodeState::reserved, NodeState::provisioned, NodeState::configured});
  const auto new_address = read_unicast(json, "new_address");
  if (!uuid || !address || !elements || *elements == 0 || !state) return std::nullopt;
  if (json.contains("new_address") && !new_address) return std::nullopt;
  Node node{.uuid = *uuid, .address = *address, .elements = *elements, .state = *state};
  node.new_address = new_address.value_or(0);
  if (new_address)  // an older file has one count for both addresses
    node.new_elements = std::max<std::uint8_t>(
        read_count(json, "new_elements", max_elements).value_or(*elements), 1);
  node.refreshed = read_step(json, "refreshed");
  node.name = read_name(json, "name");
  node.device_key = read_octets(json, "device_key");
  const bool has_radio_key = json.contains("device_key") && json["device_key"].is_null();
  if (!node.device_key && !has_radio_key && node.state != NodeState::reserved) return std::nullopt;
  if (!read_applied(json, node) || !read_wishes(json, node.wishes)) return std::nullopt;
  return node;
}

bool read_nodes(const Json& json, NodeDatabase& database) {
  return read_list(json, "nodes", NodeDatabase::max_nodes, [&](const Json& each) {
    const auto node = read_node(each);
    if (!node || database.find(node->uuid) ||
        !is_address_free(database, node->address, node->elements, {}, node->uuid) ||
        !is_address_free(database, node->joining_address(), node->joining_elements(), {},
                         node->uuid))
      return false;
    database.nodes.push_back(*node);
    return true;
  });
}

bool read_removed(const Json& json, NodeDatabase& database) {
  return read_list(json, "removed", NodeDatabase::max_removed, [&](const Json& each) {
    const auto uuid = read_octets(each, "uuid");
    const auto address = read_unicast(each, "address");
    const auto elements = read_count(each, "elements", max_elements);
    if (!uuid || !address || !elements) return false;
    database.removed.push_back({*uuid, *address, *elements});
    return true;
  });
}

/// Returns false if the member is damaged.
bool read_gateways(const Json& json, NodeDatabase& database) {
  if (json.contains("guest")) {
    database.guest_address = read_unicast(json, "guest");
    if (!database.guest_address) return false;
    database.guest_addresses =
        std::max<std::uint16_t>(read_count(json, "guest_addresses", max_sources).value_or(1), 1);
    database.host = read_name(json, "host");
  }
  return read_list(json, "gateways", first_robot_address, [&](const Json& each) {
    const auto address = unicast_of(each);
    if (address) database.gateways.push_back(*address);
    return address.has_value();
  });
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
  for (const Json& key : member(json, list))
    if (read_count(key, "index", 0U)) return read_octets(key, "key");
  return std::nullopt;
}

bool is_configured(const Json& node) {
  return member(node, "configComplete") == true || !member(node, "appKeys").empty();
}

std::optional<Node> read_imported_node(const Json& json) {
  const auto uuid = read_octets(json, "UUID");
  const auto device_key = read_octets(json, "deviceKey");
  const auto address = read_unicast(json, "unicastAddress");
  if (!uuid || !device_key || !address) return std::nullopt;
  const std::size_t count = std::max<std::size_t>(member(json, "elements").size(), 1);
  if (count > max_elements) return std::nullopt;
  Node node{.uuid = *uuid, .address = *address, .elements = static_cast<std::uint8_t>(count)};
  node.device_key = device_key;
  node.state = is_configured(json) ? NodeState::configured : NodeState::provisioned;
  node.name = read_name(json, "name");
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
  const auto read = [&](const Json& each) {
    auto node = read_imported_node(each);
    if (!node) return false;
    // The robots' names must differ, unlike those in the tool.
    if (std::ranges::find(database.nodes, node->name, &Node::name) != database.nodes.end())
      node->name.clear();
    database.nodes.push_back(std::move(*node));
    return true;
  };
  if (read_list(json, "nodes", NodeDatabase::max_nodes, read)) return database;
  const Json& nodes = member(json, "nodes");
  if (nodes.is_array() && nodes.size() <= NodeDatabase::max_nodes)
    return Refusal{fmt::format("nodes[{}] lacks a UUID, a deviceKey or a unicastAddress",
                               database.nodes.size())};
  return Refusal{
      fmt::format("`nodes` must be a list with at most {} entries", NodeDatabase::max_nodes)};
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
