// SPDX-License-Identifier: Apache-2.0
#include "daemon/upstream/paho_message.hpp"

#include <fmt/format.h>
#include <mqtt/connect_options.h>

#include <utility>

namespace slamgw {
namespace {

mqtt::properties user_properties(const Provenance& provenance, const std::string& gateway_id) {
  using mqtt::property;
  mqtt::properties properties;
  const auto add = [&](const char* name, const std::string& value) {
    properties.add(property(property::USER_PROPERTY, mqtt::string(name), mqtt::string(value)));
  };
  add("mesh", std::string(to_string(provenance.mesh)));
  add("gateway", gateway_id);
  add("received_at", to_iso8601_ms(provenance.received_at));
  return properties;
}

}  // namespace

mqtt::const_message_ptr to_paho(const BrokerMessage& message, MqttVersion version,
                                const std::string& gateway_id) {
  mqtt::properties properties;
  if (version == MqttVersion::v5 && message.provenance)
    properties = user_properties(*message.provenance, gateway_id);
  return mqtt::message::create(message.topic, message.payload.data(), message.payload.size(),
                               static_cast<int>(message.qos), message.retain, properties);
}

BrokerMessage from_paho(const mqtt::message& message) {
  return {message.get_topic(), to_bytes(message.get_payload()), static_cast<Qos>(message.get_qos()),
          message.is_retained(), std::nullopt};
}

std::vector<std::uint32_t> subscriptions_of(const mqtt::message& message) {
  std::vector<std::uint32_t> ids;
  const mqtt::properties& properties = message.get_properties();
  const std::size_t count = properties.count(mqtt::property::SUBSCRIPTION_IDENTIFIER);
  for (std::size_t i = 0; i < count; ++i) {
    ids.push_back(mqtt::get<std::uint32_t>(properties, mqtt::property::SUBSCRIPTION_IDENTIFIER, i));
  }
  return ids;
}

std::uint16_t receive_maximum_of(const mqtt::token& token, MqttVersion version) {
  constexpr std::uint16_t unlimited = 65535;
  if (version != MqttVersion::v5) return unlimited;
  const mqtt::connect_response response = token.get_connect_response();
  const mqtt::properties& properties = response.get_properties();
  if (!properties.contains(mqtt::property::RECEIVE_MAXIMUM)) return unlimited;
  return mqtt::get<std::uint16_t>(properties, mqtt::property::RECEIVE_MAXIMUM);
}

std::string server_uri(const BrokerSettings& settings, const std::string& host) {
  const bool is_ipv6 = host.find(':') != std::string::npos;
  return fmt::format("{}://{}:{}", settings.tls ? "ssl" : "tcp", is_ipv6 ? "[" + host + "]" : host,
                     settings.port);
}

}  // namespace slamgw
