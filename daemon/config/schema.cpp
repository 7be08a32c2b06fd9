// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/schema.hpp"

#include <algorithm>
#include <array>

#include "daemon/config/rules.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {
namespace {

constexpr std::uint64_t day_s = 86400;
constexpr std::uint64_t max_u16 = 65535;
constexpr double max_cm = 1e6;  // ten kilometres
constexpr std::uint64_t tebibyte = 1ULL << 40;
constexpr TextRule any_text{[](std::string_view) { return true; }, "a text"};
constexpr TextRule ban{Bans::is_valid,
                       "a robot's id, an address or a network such as fd00::/64, without spaces"};
constexpr TextRule client_id{is_client_id, "a text of 1-255 bytes without control characters"};
constexpr TextRule filter{
    is_valid_filter,
    "an MQTT filter, + only as a whole level, # only as the last, at most 200 levels, no control "
    "characters"};
constexpr TextRule level{is_valid_level,
                         "a text of 1-64 bytes without + # / and control characters"};
constexpr TextRule listen_address{is_listen_address, "\"[IPv6]:PORT\" or \"IPv4:PORT\""};
constexpr TextRule network{[](std::string_view text) { return IpNetwork::parse(text).has_value(); },
                           "an IP address, or a network such as fd00::/64"};
constexpr TextRule prefix{
    is_topic_prefix,
    "topic levels of at most 64 bytes, 128 in all, without wildcards, not empty, no / at either "
    "end, no $ in front"};
constexpr TextRule relay_filter{is_relay_filter,
                                "\"robot/+/update\", or \"robot/ID/update\" of one robot, because "
                                "BLE robots hear updates only"};
constexpr TextRule retained_type{
    [](std::string_view type) { return type == "*" || is_valid_level(type); },
    "the last level of a topic, such as \"map\", or \"*\" for any"};
constexpr TextRule topic{
    is_valid_topic_name,
    "a topic name without wildcards and control characters, at most 200 levels"};

// Functions for keys that need more than one call, then the table.

std::optional<BrokerAddress> broker_address(Value value) {
  const auto* text = value.json().get_ptr<const std::string*>();
  if (text != nullptr && text->find('@') != std::string::npos) {
    value.problem(  // never shown: it may hold a password
        "a user name or password in the URI is not allowed; allowed: mqtt://HOST[:PORT], and the "
        "user in the file that broker.credentials_file names");
    return std::nullopt;
  }
  if (const auto address = text ? parse_broker_uri(*text) : std::nullopt) return address;
  value.not_allowed("mqtt://HOST[:PORT] or mqtts://HOST[:PORT], IPv6 in [ ], or a list of them",
                    text != nullptr);
  return std::nullopt;
}

void read_broker_uri(Value value, Config& config) {
  std::vector<BrokerAddress> brokers;
  const auto read = [&brokers](Value each) {
    const auto address = broker_address(each);
    if (address) each.add_once(brokers, *address);
  };
  if (!value.json().is_array()) {
    read(value);
  } else if (value.json().empty()) {
    value.not_allowed("mqtt://HOST[:PORT] or mqtts://HOST[:PORT], or a list of them", false);
  } else {
    value.list(read, "broker URIs");
  }
  if (brokers.empty()) return;
  config.broker.host = brokers.front().host;
  config.broker.port = brokers.front().port;
  config.broker.tls = brokers.front().tls;
  config.broker.others.assign(brokers.begin() + 1, brokers.end());
}

void read_groups(Value value, Config& config) {
  auto& groups = config.ble_mesh.groups;
  if (value.json().is_array()) groups.clear();
  value.list(
      [&groups](Value item) {
        std::uint16_t group = 0;
        item.address(group, 0xc000, 0xfeff);
        if (group != 0) item.add_once(groups, group);
      },
      "group addresses");
}

/// Clears a list at its begin, and appends each element.
template <class Element>
void begin(Value value, std::vector<Element>& list) {
  if (value.json().is_array())
    list.clear();
  else
    list.emplace_back();
}

bool is_controller(std::string_view name) {
  constexpr std::string_view prefix = "hci";
  constexpr std::size_t most_digits = 3;
  if (!name.starts_with(prefix)) return false;
  name.remove_prefix(prefix.size());
  return !name.empty() && name.size() <= most_digits &&
         name.find_first_not_of("0123456789") == name.npos;
}

/// Refuses 1 (Mesh Profile section 3.4.4.5): such a message is never relayed, as with 0.
void read_ttl(Value value, Config& config) {
  const Json& json = value.json();
  const std::uint64_t ttl = json.is_number_unsigned() ? json.get<std::uint64_t>() : 1;
  if (ttl > 127 || ttl == 1)
    return value.not_allowed("0 or a whole number from 2 to 127", json.is_number());
  config.ble_mesh.ttl = static_cast<std::uint8_t>(ttl);
}

constexpr auto all_keys = std::to_array<SchemaKey>({
    {"gateway.id",
     [](Value v, Config& c) {
       v.text(c.gateway_id, {is_gateway_id, "1-32 letters, digits, - and _"});
     }},
    {"broker.uri", read_broker_uri},
    {"broker.client",
     [](Value v, Config& c) {
       v.one_of(c.broker.client,
                {{"paho", MqttClient::paho}, {"mosquitto", MqttClient::mosquitto}});
     }},
    {"broker.cluster", [](Value v, Config& c) { v.boolean(c.broker.is_cluster); }},
    {"broker.return_to_first", [](Value v, Config& c) { v.boolean(c.broker.returns_to_first); }},
    {"broker.client_id", [](Value v, Config& c) { v.text(c.broker.client_id, client_id); }},
    {"broker.credentials_file", [](Value v, Config& c) { v.file_path(c.broker.credentials_file); }},
    {"broker.tls.ca_file", [](Value v, Config& c) { v.file_path(c.broker.ca_file); }},
    {"broker.tls.certificate_file",
     [](Value v, Config& c) { v.file_path(c.broker.certificate_file); }},
    {"broker.tls.key_file", [](Value v, Config& c) { v.file_path(c.broker.key_file); }},
    {"broker.keep_alive_s", [](Value v, Config& c) { v.seconds(c.broker.keep_alive, 1, max_u16); }},
    {"broker.max_inflight", [](Value v, Config& c) { v.integer(c.broker.max_inflight, 1, 1000); }},
    {"topics.prefix", [](Value v, Config& c) { v.text(c.topics.prefix, prefix); }},
    {"topics.extra_publish", [](Value v, Config& c) { v.texts(c.topics.extra_publish, filter); }},
    {"topics.extra_subscribe",
     [](Value v, Config& c) { v.texts(c.topics.extra_subscribe, filter); }},
    {"topics.retain", [](Value v, Config& c) { v.texts(c.topics.retain, retained_type); }},
    {"topics.home_assistant", [](Value v, Config& c) { v.boolean(c.topics.home_assistant); }},
    {"bans", [](Value v, Config& c) { v.texts(c.bans, ban); }},
    {"payload.update",
     [](Value v, Config& c) {
       v.one_of(c.update_mode, {{"positions", UpdateMode::positions},
                                {"json", UpdateMode::json},
                                {"raw", UpdateMode::raw}});
     }},
    {"presence.offline_after_s",
     [](Value v, Config& c) { v.seconds(c.ble_mesh.offline_after, 1, day_s); }},
    {"robots[]", [](Value v, Config& c) { begin(v, c.robots); }},
    {"robots[].id", [](Value v, Config& c) { v.text(c.robots.back().id, level); }},
    {"robots[].ble_address",
     [](Value v, Config& c) { v.address(c.robots.back().ble_address, 0x0001, 0x7fff); }},
    {"robots[].mqttsn_client_id",
     [](Value v, Config& c) { v.text(c.robots.back().mqttsn_client_id, level); }},
    {"robots[].address", [](Value v, Config& c) { v.text(c.robots.back().address, network); }},
    {"robots[].prefer",
     [](Value v, Config& c) {
       v.one_of(c.robots.back().prefer,
                {{"auto", std::nullopt}, {"ble", Mesh::ble}, {"thread", Mesh::thread}});
     }},
    {"robots[].origin",
     [](Value v, Config& c) {
       if (!v.is_null()) c.robots.back().origin.emplace();
     }},
    {"robots[].origin.x_cm",
     [](Value v, Config& c) { v.number(c.robots.back().origin->x_cm, -max_cm, max_cm); }},
    {"robots[].origin.y_cm",
     [](Value v, Config& c) { v.number(c.robots.back().origin->y_cm, -max_cm, max_cm); }},
    {"robots[].origin.heading_deg",
     [](Value v, Config& c) { v.number(c.robots.back().origin->heading_deg, -360, 360); }},
    {"store.directory", [](Value v, Config& c) { v.file_path(c.store.directory); }},
    {"store.max_bytes", [](Value v, Config& c) { v.integer(c.store.max_bytes, 1, tebibyte); }},
    {"log.level",
     [](Value v, Config& c) {
       v.one_of(c.log.level, {{"debug", Severity::debug},
                              {"info", Severity::info},
                              {"notice", Severity::notice},
                              {"warning", Severity::warning},
                              {"error", Severity::error}});
     }},
    {"log.traffic",
     [](Value v, Config& c) {
       v.one_of(c.log.traffic, {{"all", TrafficLogMode::all},
                                {"sampled", TrafficLogMode::sampled},
                                {"off", TrafficLogMode::off}});
     }},
    {"control.socket", [](Value v, Config& c) { v.file_path(c.control_socket); }},
    {"web.listen", [](Value v, Config& c) { v.text(c.web.listen, listen_address); }},
    {"web.note_file", [](Value v, Config& c) { v.file_path(c.web.note_file); }},
    {"web.token_file", [](Value v, Config& c) { v.file_path(c.web.token_file); }},
    {"web.hosts",
     [](Value v, Config& c) {
       v.texts(c.web.hosts, {is_host_name, "host names without a port, like \"slam.example.org\""});
     }},
    {"ble_mesh.enabled", [](Value v, Config& c) { v.boolean(c.ble_mesh.enabled); }},
    {"ble_mesh.radio",
     [](Value v, Config& c) {
       v.one_of(c.ble_mesh.radio,
                {{"nordic", ble::RadioChoice::nordic}, {"bluez", ble::RadioChoice::bluez}});
     }},
    {"ble_mesh.controller",
     [](Value v, Config& c) {
       v.text(c.ble_mesh.controller, {is_controller, "\"hci0\", \"hci1\" ..."});
     }},
    {"ble_mesh.device", [](Value v, Config& c) { v.file_path(c.ble_mesh.device, "auto"); }},
    {"ble_mesh.protocol",
     [](Value v, Config& c) {
       v.one_of(c.ble_mesh.protocol,
                {{"nordic-serial", ble::Protocol::nordic_serial}, {"cobs", ble::Protocol::cobs}});
     }},
    {"ble_mesh.baud_rate",
     [](Value v, Config& c) { v.integer(c.ble_mesh.baud_rate, 1200, 4000000); }},
    {"ble_mesh.flow_control",
     [](Value v, Config& c) {
       v.one_of(c.ble_mesh.flow_control, {{"auto", ble::FlowControl::automatic},
                                          {"none", ble::FlowControl::none},
                                          {"rts_cts", ble::FlowControl::rts_cts}});
     }},
    {"ble_mesh.address", [](Value v, Config& c) { v.address(c.ble_mesh.address, 0x0001, 0x7fff); }},
    {"ble_mesh.ttl", read_ttl},
    {"ble_mesh.groups", read_groups},
    {"ble_mesh.gateway_group",
     [](Value v, Config& c) { v.address(c.ble_mesh.gateway_group, 0xc000, 0xfeff); }},
    {"ble_mesh.relay", [](Value v, Config& c) { v.texts(c.ble_mesh.relay, relay_filter); }},
    {"ble_mesh.relay_group",
     [](Value v, Config& c) { v.address(c.ble_mesh.relay_group, 0xc000, 0xfeff); }},
    {"ble_mesh.types.min_com", [](Value v, Config& c) { v.text(c.ble_mesh.min_com_type, level); }},
    {"ble_mesh.types.sensor_update",
     [](Value v, Config& c) { v.text(c.ble_mesh.sensor_update_type, level); }},
    {"ble_mesh.types.pos_cmd", [](Value v, Config& c) { v.text(c.ble_mesh.pos_cmd_type, level); }},
    {"ble_mesh.on_off_model",
     [](Value v, Config& c) {
       v.one_of(c.ble_mesh.on_off_model,
                {{"generic", ble::OnOffModel::generic}, {"simple", ble::OnOffModel::simple}});
     }},
    {"ble_mesh.provisioning.enabled",
     [](Value v, Config& c) { v.boolean(c.ble_mesh.provisioning.enabled); }},
    {"ble_mesh.provisioning.over_mqtt",
     [](Value v, Config& c) { v.boolean(c.ble_mesh.provisioning.over_mqtt); }},
    {"ble_mesh.provisioning.uuid_prefixes",
     [](Value v, Config& c) {
       v.texts(c.ble_mesh.provisioning.uuid_prefixes, {is_uuid_prefix, "1-32 hex digits"});
     }},
    {"ble_mesh.provisioning.static_oob",
     [](Value v, Config& c) {
       v.secret(c.ble_mesh.provisioning.static_oob, {is_static_oob, "32 hex digits"});
     }},
    {"ble_mesh.will",
     [](Value v, Config& c) {
       if (v.is_null())
         c.ble_mesh.will.reset();
       else if (!c.ble_mesh.will)
         c.ble_mesh.will.emplace();
     }},
    {"ble_mesh.will.topic", [](Value v, Config& c) { v.text(c.ble_mesh.will->topic, topic); }},
    {"ble_mesh.will.message",
     [](Value v, Config& c) { v.text(c.ble_mesh.will->message, any_text); }},
    {"ble_mesh.cobs_content",
     [](Value v, Config& c) {
       v.one_of(c.ble_mesh.cobs_content,
                {{"positions", ble::CobsContent::positions}, {"lien", ble::CobsContent::lien}});
     }},
    {"ble_mesh.robot_id", [](Value v, Config& c) { v.text(c.ble_mesh.robot_id, level); }},
    {"mqttsn.enabled", [](Value v, Config& c) { v.boolean(c.mqttsn.enabled); }},
    {"mqttsn.listen", [](Value v, Config& c) { v.texts(c.mqttsn.listen, listen_address); }},
    {"mqttsn.interface",
     [](Value v, Config& c) {
       std::optional<std::string> name;
       v.text(name, {is_interface_name, "\"auto\", \"*\", or the name of a network interface"});
       c.mqttsn.interface = name.value_or("auto");
     }},
    {"mqttsn.announce", [](Value v, Config& c) { v.boolean(c.mqttsn.announce); }},
    {"mqttsn.multicast_group",
     [](Value v, Config& c) {
       v.text(c.mqttsn.multicast_group,
              {is_multicast_group, "an IPv6 or IPv4 multicast address without a port"});
     }},
    {"mqttsn.gateway_id", [](Value v, Config& c) { v.integer(c.mqttsn.gateway_id, 1, 255); }},
    {"mqttsn.advertise_interval_s",
     [](Value v, Config& c) { v.seconds(c.mqttsn.advertise_interval, 1, max_u16); }},
    {"mqttsn.predefined_topics[]",
     [](Value v, Config& c) { begin(v, c.mqttsn.predefined_topics); }},
    {"mqttsn.predefined_topics[].id",
     [](Value v, Config& c) { v.integer(c.mqttsn.predefined_topics.back().id, 1, 65534); }},
    {"mqttsn.predefined_topics[].name",
     [](Value v, Config& c) { v.text(c.mqttsn.predefined_topics.back().name, topic); }},
    {"mqttsn.predefined_topics[].client_id",
     [](Value v, Config& c) { v.text(c.mqttsn.predefined_topics.back().client_id, level); }},
    {"mqttsn.allow_unconnected_publish",
     [](Value v, Config& c) { v.boolean(c.mqttsn.allow_unconnected_publish); }},
    {"mqttsn.max_clients", [](Value v, Config& c) { v.integer(c.mqttsn.max_clients, 1, 1000000); }},
    {"mqttsn.max_sleeping_messages",
     [](Value v, Config& c) { v.integer(c.mqttsn.max_sleeping_messages, 1, max_u16); }},
    {"mqttsn.keep_alive_tolerance",
     [](Value v, Config& c) { v.number(c.mqttsn.keep_alive_tolerance, 1.0, 100.0); }},
    {"mqttsn.retry_interval_s",
     [](Value v, Config& c) { v.seconds(c.mqttsn.retry_interval, 1, 3600); }},
    {"mqttsn.retry_count", [](Value v, Config& c) { v.integer(c.mqttsn.retry_count, 0, 100); }},
    {"mqttsn.when_full",
     [](Value v, Config& c) {
       v.one_of(c.mqttsn.when_full,
                {{"silent", mqttsn::WhenFull::silent}, {"reject", mqttsn::WhenFull::reject}});
     }},
    {"mqttsn.revive_lost", [](Value v, Config& c) { v.boolean(c.mqttsn.revive_lost); }},
    {"mqttsn.forwarders", [](Value v, Config& c) { v.boolean(c.mqttsn.forwarders); }},
    {"mqttsn.disconnect_unknown",
     [](Value v, Config& c) { v.boolean(c.mqttsn.disconnect_unknown); }},
    {"mqttsn.dtls.listen",
     [](Value v, Config& c) { v.texts(c.mqttsn.dtls.listen, listen_address); }},
    {"mqttsn.dtls.keys_file", [](Value v, Config& c) { v.file_path(c.mqttsn.dtls.keys_file); }},
    {"mqttsn.require_identity",
     [](Value v, Config& c) {
       using mqttsn::RequireIdentity;
       RequireIdentity& required = c.mqttsn.require_identity;
       const Json& value = v.json();
       if (value == "all") {
         required = RequireIdentity::all;
       } else if (value.is_boolean()) {
         required = value.get<bool>() ? RequireIdentity::with_key : RequireIdentity::none;
       } else {
         v.not_allowed("false, true, \"all\"", value.is_string());
       }
     }},
});

}  // namespace

std::span<const SchemaKey> schema() { return all_keys; }

const SchemaKey* find_key(std::string_view path) {
  const auto found = std::find_if(all_keys.begin(), all_keys.end(),
                                  [path](const SchemaKey& key) { return key.path == path; });
  return found == all_keys.end() ? nullptr : &*found;
}

bool is_group(std::string_view path) {
  return std::any_of(all_keys.begin(), all_keys.end(), [path](const SchemaKey& key) {
    return key.path.size() > path.size() && key.path.starts_with(path) &&
           key.path[path.size()] == '.';
  });
}

}  // namespace slamgw
