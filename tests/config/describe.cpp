// SPDX-License-Identifier: Apache-2.0
#include "tests/config/describe.hpp"

#include <type_traits>

namespace slamgw::test {
namespace {

std::string show(const std::string& value) { return "'" + value + "'"; }

template <class T>
requires std::is_arithmetic_v<T> std::string show(T value) { return std::to_string(value); }

template <class T>
requires std::is_enum_v<T> std::string show(T value) {
  return std::to_string(static_cast<int>(value));
}

std::string show(std::chrono::seconds value) { return std::to_string(value.count()) + "s"; }
std::string show(const Credentials& value);
std::string show(const RobotName& value);
std::string show(const RobotOrigin& value);
std::string show(const BrokerAddress& value);
std::string show(const ble::WillSettings& value);
std::string show(const mqttsn::PredefinedTopic& value);

template <class T>
std::string show(const std::optional<T>& value) {
  return value ? show(*value) : "none";
}

template <class T>
std::string show(const std::vector<T>& values) {
  std::string result = "[";
  for (const T& value : values) result += show(value) + " ";
  return result + "]";
}

template <class... T>
std::string all(const T&... values) {
  return "{" + (... + (show(values) + ", ")) + "}\n";
}

std::string show(const Credentials& value) {
  const auto& [username, password] = value;
  return all(username, password);
}

std::string show(const RobotOrigin& value) {
  const auto& [x_cm, y_cm, heading_deg] = value;
  return all(x_cm, y_cm, heading_deg);
}

std::string show(const BrokerAddress& value) {
  const auto& [host, port, tls] = value;
  return all(host, port, tls);
}

std::string show(const RobotName& value) {
  const auto& [id, ble_address, mqttsn_client_id, origin, address, prefer] = value;
  return all(id, ble_address, mqttsn_client_id, origin, address, prefer);
}

std::string show(const ble::WillSettings& value) {
  const auto& [topic, message] = value;
  return all(topic, message);
}

std::string show(const mqttsn::PredefinedTopic& value) {
  const auto& [id, name, client_id] = value;
  return all(id, name, client_id);
}

std::string describe_ble_mesh(const ble::Settings& settings) {
  const auto& [enabled, radio, controller, device, protocol, baud_rate, flow_control, address, ttl,
               groups, gateway_group, relay, relay_group, min_com, sensor_update, pos_cmd,
               on_off_model, provisioning, will, cobs_content, robot_id, offline_after] = settings;
  const auto& [is_provisioning, uuid_prefixes, static_oob, over_mqtt] = provisioning;
  return all(enabled, radio, controller, device, protocol, baud_rate, flow_control, address, ttl,
             groups, gateway_group, relay, relay_group, min_com, sensor_update, pos_cmd,
             on_off_model, is_provisioning, uuid_prefixes, static_oob, over_mqtt, will,
             cobs_content, robot_id, offline_after);
}

std::string describe_mqttsn(const mqttsn::Settings& settings) {
  const auto& [enabled, listen, interface, announce, multicast_group, gateway_id,
               advertise_interval, predefined_topics, allow_unconnected_publish, max_clients,
               max_sleeping_messages, keep_alive_tolerance, retry_interval, retry_count, when_full,
               revive_lost, forwarders, disconnect_unknown, dtls, require_identity] = settings;
  const auto& [dtls_listen, keys_file] = dtls;
  return all(enabled, listen, interface, announce, multicast_group, gateway_id, advertise_interval,
             predefined_topics, allow_unconnected_publish, max_clients, max_sleeping_messages,
             keep_alive_tolerance, retry_interval, retry_count, when_full, revive_lost, forwarders,
             disconnect_unknown, dtls_listen, keys_file, require_identity);
}

std::string describe_broker(const BrokerSettings& settings) {
  const auto& [client, host, port, tls, others, is_cluster, returns_to_first, gateway_id, client_id,
               credentials_file, credentials, ca_file, certificate_file, key_file, keep_alive,
               max_inflight] = settings;
  return all(client, host, port, tls, others, is_cluster, returns_to_first, gateway_id, client_id,
             credentials_file, credentials, ca_file, certificate_file, key_file, keep_alive,
             max_inflight);
}

}  // namespace

std::string describe(const Config& config) {
  const auto& [gateway_id, broker, topics, update_mode, robots, bans, ble_mesh, mqttsn, robot_keys,
               store, log, control_socket, web] = config;
  const auto& [prefix, extra_publish, extra_subscribe, retain, home_assistant] = topics;
  const auto& [directory, max_bytes] = store;
  const auto& [level, traffic] = log;
  const auto& [listen, token_file, note_file, hosts] = web;
  std::vector<std::string> keys;
  for (const auto& [identity, key] : robot_keys) keys.push_back(identity + "=" + to_hex(key));
  return describe_broker(broker) + describe_ble_mesh(ble_mesh) + describe_mqttsn(mqttsn) +
         all(gateway_id, prefix, extra_publish, extra_subscribe, retain, home_assistant,
             update_mode, robots, bans, keys, directory, max_bytes, level, traffic, control_socket,
             listen, token_file, note_file, hosts);
}

}  // namespace slamgw::test
