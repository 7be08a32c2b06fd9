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

// Readers of the JSON files of a mesh. They throw a Json::exception if a value is invalid; must(),
// too, if the member is missing.

void require(bool is_valid) {
  if (!is_valid) throw Json::other_error::create(501, "invalid value", nullptr);
}

/// Returns nothing for an invalid value.
auto tried(const auto& read, const Json& json) -> std::optional<decltype(read(json))> {
  try {
    return read(json);
  } catch (const Json::exception&) {
    return std::nullopt;
  }
}

auto must(const Json& json, const char* name, const auto& read) { return read(json.at(name)); }

/// Returns nothing for a missing or invalid member.
auto may(const Json& json, const char* name, const auto& read) {
  return json.contains(name) ? tried(read, json.at(name)) : decltype(tried(read, json))();
}

/// Reads a list of at most `max` values, or none if the list is missing.
auto read_list(const Json& json, const char* name, std::size_t max, const auto& read) {
  std::vector<decltype(read(json))> values;
  if (!json.contains(name)) return values;
  const Json& list = json.at(name);
  require(list.is_array() && list.size() <= max);
  for (const Json& each : list) values.push_back(read(each));
  return values;
}

std::string text(const Json& json) { return json.get<std::string>(); }
bool flag(const Json& json) { return json.get<bool>(); }

/// Reads a name of a robot or a gateway.
std::string level(const Json& json) {
  require(is_valid_level(text(json)));
  return text(json);
}

/// Reads a whole number from 0 to `max`.
template <class Number>
auto count(Number max) {
  return [max](const Json& json) {
    require(json.is_number_unsigned() && json.get<std::uint64_t>() <= max);
    return json.get<Number>();
  };
}

/// Reads the text of one of these values.
template <class Value>
Value one_of(const Json& json, std::initializer_list<Value> values) {
  const std::string written = text(json);
  const auto found =
      std::ranges::find_if(values, [&](const Value value) { return to_string(value) == written; });
  require(found != values.end());
  return *found;
}

/// Reads 32 hex digits, any case; UUIDs also with hyphens.
Uuid octets(const Json& json) {
  const auto read = parse_uuid(text(json));
  require(read.has_value());
  return *read;
}

/// Reads up to 4 hex digits with or without 0x.
std::uint16_t hex_number(const Json& json) {
  const std::string written = text(json);
  std::string_view digits = written;
  if (digits.starts_with("0x")) digits.remove_prefix(2);
  const auto number = parse_number<std::uint16_t>(digits, hexadecimal);
  require(number.has_value());
  return *number;
}

/// Reads a group address, 0xc000-0xfeff.
std::uint16_t group(const Json& json) {
  const std::uint16_t address = hex_number(json);
  require(address >= first_group && address <= last_group);
  return address;
}

/// Reads a number, or text as hex_number() does; 0x0001-0x7fff.
std::uint16_t unicast(const Json& json) {
  const std::uint16_t address =
      json.is_number() ? count(last_unicast_address)(json) : hex_number(json);
  require(address > 0 && address <= last_unicast_address);
  return address;
}

/// Reads a unicast address, or a group address.
std::uint16_t destination(const Json& json) {
  const auto address = tried(unicast, json);
  return address ? *address : group(json);
}

RefreshStep refresh_step(const Json& json) {
  return one_of(json, {RefreshStep::distributing, RefreshStep::switching, RefreshStep::finishing});
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
  if (node.is_joining) json["joining"] = true;
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

RadioLife read_life(const Json& json) {
  RadioLife life{.number = must(json, "number", count(UINT32_MAX)),
                 .source = may(json, "source", unicast).value_or(0),
                 .radio = may(json, "board", text).value_or("")};
  const std::string kind = must(json, "kind", text);
  for (const RadioKind each : {RadioKind::forgets, RadioKind::keeps})
    if (kind == to_string(each)) life.kind = each;
  return life;
}

RefreshState read_refresh(const Json& json) {
  return {must(json, "step", refresh_step),
          {must(json, "net_key", octets), must(json, "app_key", octets)}};
}

/// Without these settings the node is left as it is.
std::optional<AppliedSettings> read_applied(const Json& json) {
  if (!json.contains("gateway") || !json.contains("groups")) return std::nullopt;
  AppliedSettings applied{must(json, "gateway", destination),
                          read_list(json, "groups", max_groups, group),
                          may(json, "changing", flag).value_or(false)};
  if (json.contains("relay_group")) applied.relay_group = must(json, "relay_group", group);
  return applied;
}

NodeWishes read_wishes(const Json& json) {
  require(json.is_object());
  NodeWishes wishes{.ttl = may(json, "ttl", count(max_ttl)),
                    .relay = may(json, "relay", flag),
                    .groups = read_list(json, "groups", NodeWishes::max_groups, group)};
  const Json publications = json.value("publications", Json());
  for (const ModelId& model : publishers)
    if (const auto address = may(publications, to_string(model).c_str(), destination))
      wishes.publications[to_string(model)] = *address;
  const auto sends = may(json, "transmit", count(max_ttl));
  const auto interval_ms = may(json, "transmit_interval_ms", count(max_interval_ms));
  if (sends && interval_ms && Transmissions::is_valid(*sends, *interval_ms))
    wishes.transmit = Transmissions{*sends, *interval_ms};
  return wishes;
}

NodeState node_state(const Json& json) {
  return one_of(json, {NodeState::reserved, NodeState::provisioned, NodeState::configured});
}

Node read_node(const Json& json) {
  Node node{.uuid = must(json, "uuid", octets),
            .address = must(json, "address", unicast),
            .elements = must(json, "elements", count(max_elements)),
            .state = must(json, "state", node_state),
            .is_joining = may(json, "joining", flag).value_or(false),
            .device_key = may(json, "device_key", octets),
            .name = may(json, "name", level).value_or(""),
            .ttl = may(json, "ttl", count(max_ttl)),
            .applied = read_applied(json),
            .refreshed = may(json, "refreshed", refresh_step).value_or(RefreshStep::none)};
  require(node.elements > 0);
  require(node.device_key || node.state == NodeState::reserved || json.at("device_key").is_null());
  if (json.contains("new_address")) {  // an older file has one count for both addresses
    node.new_address = must(json, "new_address", unicast);
    node.new_elements = std::max<std::uint8_t>(
        may(json, "new_elements", count(max_elements)).value_or(node.elements), 1);
  }
  if (json.contains("wanted")) node.wishes = must(json, "wanted", read_wishes);
  return node;
}

RemovedNode read_removed(const Json& json) {
  return {must(json, "uuid", octets), must(json, "address", unicast),
          must(json, "elements", count(max_elements))};
}

NodeDatabase read_database(const Json& json) {
  require(must(json, "version", count(format_version)) == format_version);
  NodeDatabase database;
  database.keys = {must(json, "net_key", octets), must(json, "app_key", octets)};
  database.iv_index = must(json, "iv_index", count(UINT32_MAX));
  database.next_address = must(json, "next_address", hex_number);
  // It is one past the last address when all were handed out.
  require(database.next_address > 0 && database.next_address <= last_unicast_address + 1);
  for (const Node& node : read_list(json, "nodes", NodeDatabase::max_nodes, read_node)) {
    require(
        !database.find(node.uuid) &&
        is_address_free(database, node.address, node.elements, {}, node.uuid) &&
        is_address_free(database, node.joining_address(), node.joining_elements(), {}, node.uuid));
    database.nodes.push_back(node);
  }
  database.removed = read_list(json, "removed", NodeDatabase::max_removed, read_removed);
  database.gateways = read_list(json, "gateways", first_robot_address, unicast);
  if (json.contains("guest")) {
    database.guest_address = must(json, "guest", unicast);
    database.guest_addresses =
        std::max<std::uint16_t>(may(json, "guest_addresses", count(max_sources)).value_or(1), 1);
    database.host = may(json, "host", level).value_or("");
  }
  database.life.number = 1;  // a file without a life predates it: robots heard the gateway
  if (json.contains("life")) database.life = must(json, "life", read_life);
  if (json.contains("refresh")) database.refresh = must(json, "refresh", read_refresh);
  return database;
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
  auto database = tried(read_database, Json::parse(text, nullptr, false));
  if (!database) return DecodeError::bad_value;
  return std::move(*database);
}

namespace {

/// Returns the key with index 0 in a list of `{"index", "key"}`.
Key read_key_0(const Json& list) {
  const auto key = std::ranges::find_if(
      list, [](const Json& each) { return may(each, "index", count(0U)).has_value(); });
  require(key != list.end());
  return must(*key, "key", octets);
}

Node read_imported_node(const Json& json) {
  Node node{.uuid = must(json, "UUID", octets),
            .address = must(json, "unicastAddress", unicast),
            .device_key = must(json, "deviceKey", octets),
            .name = may(json, "name", level).value_or("")};
  const std::size_t elements = std::max<std::size_t>(json.value("elements", Json()).size(), 1);
  require(elements <= max_elements);
  node.elements = static_cast<std::uint8_t>(elements);
  const bool is_configured =
      may(json, "configComplete", flag).value_or(false) || !json.value("appKeys", Json()).empty();
  node.state = is_configured ? NodeState::configured : NodeState::provisioned;
  return node;
}

Result<NodeDatabase, Refusal> decode_tool_database(const Json& json) {
  const auto net_key = may(json, "netKeys", read_key_0);
  const auto app_key = may(json, "appKeys", read_key_0);
  if (!net_key || !app_key)
    return Refusal{"it has no network key 0 (netKeys) or no application key 0 (appKeys)"};
  NodeDatabase database;
  database.keys = {*net_key, *app_key};
  database.life.number = 1;  // the tool's own radio
  database.iv_index = may(json, "ivIndex", count(UINT32_MAX)).value_or(0);
  const Json nodes = json.value("nodes", Json::array());
  if (!nodes.is_array() || nodes.size() > NodeDatabase::max_nodes)
    return Refusal{
        fmt::format("`nodes` must be a list with at most {} entries", NodeDatabase::max_nodes)};
  for (const Json& each : nodes) {
    auto node = tried(read_imported_node, each);
    if (!node)
      return Refusal{fmt::format("nodes[{}] lacks a UUID, a deviceKey or a unicastAddress",
                                 database.nodes.size())};
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
        "first (and clear the radio: ble reset-board), then import again"};
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
