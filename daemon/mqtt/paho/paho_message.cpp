// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho/paho_message.hpp"

#include <fmt/format.h>
#include <mqtt/connect_options.h>

#include <algorithm>
#include <iterator>
#include <string_view>
#include <utility>

#include "daemon/mqtt/user_properties.hpp"

namespace slamgw {
namespace {

MQTTLenString view_of(std::string_view text) {
  return {static_cast<int>(text.size()), const_cast<char*>(text.data())};  // Paho only reads it
}

MQTTProperty user_property(std::string_view name, std::string_view value) {
  MQTTProperty property{};
  property.identifier = MQTTPROPERTY_CODE_USER_PROPERTY;
  property.value.data = view_of(name);
  property.value.value = view_of(value);
  return property;
}

/// Returns the properties with a placeholder for `received_at`, which write_time() overwrites.
mqtt::properties user_properties(Mesh mesh, const std::string& gateway_id) {
  const std::string received_at = to_iso8601_ms(WallTime{});
  MQTTProperty list[] = {user_property(mesh_property, to_string(mesh)),
                         user_property(gateway_property, gateway_id),
                         user_property(received_at_property, received_at)};
  MQTTProperties properties = MQTTProperties_initializer;
  properties.count = static_cast<int>(std::size(list));
  properties.array = list;
  return mqtt::properties(properties);  // copies
}

}  // namespace

PublishForm::PublishForm(MqttVersion version, const std::string& gateway_id) : version_(version) {
  for (auto& form : forms_) form = std::make_shared<mqtt::message>();
  form_without_provenance_ = std::make_shared<mqtt::message>();
  if (version != MqttVersion::v5) return;
  for (const Mesh mesh : all_meshes)
    forms_[mesh]->set_properties(user_properties(mesh, gateway_id));
}

const std::shared_ptr<mqtt::message>& PublishForm::form_of(const BrokerMessage& message) const {
  return message.provenance ? forms_[message.provenance->mesh] : form_without_provenance_;
}

mqtt::const_message_ptr PublishForm::fill(const BrokerMessage& message) {
  const std::shared_ptr<mqtt::message>& form = form_of(message);
  form->set_topic(message.topic);
  form->set_payload(message.payload.data(), message.payload.size());
  form->set_qos(static_cast<int>(message.qos));
  form->set_retained(message.retain);
  if (message.provenance) write_time(*form, message.provenance->received_at);
  return form;
}

void PublishForm::write_time(mqtt::message& form, WallTime time) {
  const MQTTProperties& properties = form.get_properties().c_struct();
  if (properties.count == 0) return;
  const MQTTLenString& place = properties.array[properties.count - 1].value.value;
  const std::string text = to_iso8601_ms(time);
  if (static_cast<std::size_t>(place.len) == text.size())
    std::copy(text.begin(), text.end(), place.data);
}

BrokerMessage from_paho(const mqtt::message& message) {
  return {message.get_topic(), to_bytes(message.get_payload()), static_cast<Qos>(message.get_qos()),
          message.is_retained()};
}

UserProperties user_properties_of(const mqtt::message& message) {
  constexpr auto user = mqtt::property::USER_PROPERTY;
  const mqtt::properties& all = message.get_properties();
  UserProperties said;
  for (std::size_t i = 0; i < all.count(user); ++i) {
    auto [name, value] = mqtt::get<mqtt::string_pair>(all, user, i);
    said.emplace_back(std::move(name), std::move(value));
  }
  return said;
}

BrokerLimits limits_of(const mqtt::token& token, MqttVersion version) {
  BrokerLimits limits;
  if (version != MqttVersion::v5) return limits;
  const mqtt::connect_response response = token.get_connect_response();
  const mqtt::properties& said = response.get_properties();
  using property = mqtt::property;
  if (said.contains(property::RECEIVE_MAXIMUM))
    limits.receive_maximum = mqtt::get<std::uint16_t>(said, property::RECEIVE_MAXIMUM);
  if (said.contains(property::MAXIMUM_PACKET_SIZE))
    limits.max_packet_bytes = mqtt::get<std::uint32_t>(said, property::MAXIMUM_PACKET_SIZE);
  if (said.contains(property::MAXIMUM_QOS))
    limits.max_qos = static_cast<Qos>(mqtt::get<std::uint8_t>(said, property::MAXIMUM_QOS));
  if (said.contains(property::RETAIN_AVAILABLE))
    limits.keeps_retained = mqtt::get<std::uint8_t>(said, property::RETAIN_AVAILABLE) != 0;
  if (said.contains(property::WILDCARD_SUBSCRIPTION_AVAILABLE))
    limits.takes_wildcards =
        mqtt::get<std::uint8_t>(said, property::WILDCARD_SUBSCRIPTION_AVAILABLE) != 0;
  return limits;
}

std::optional<int> refusal_of(const mqtt::token& token) {
  constexpr int first_refusal = 0x80;
  const mqtt::ReasonCode reason = token.get_reason_code();
  if (reason != mqtt::ReasonCode::MQTTPP_V3_CODE)
    return reason >= first_refusal ? std::optional(static_cast<int>(reason)) : std::nullopt;
  const bool is_refused = token.get_return_code() == first_refusal;
  return is_refused ? std::optional(first_refusal) : std::nullopt;
}

std::string server_uri(const BrokerSettings& settings, const std::string& host) {
  const bool is_ipv6 = host.find(':') != std::string::npos;
  return fmt::format("{}://{}:{}", settings.tls ? "ssl" : "tcp", is_ipv6 ? "[" + host + "]" : host,
                     settings.port);
}

}  // namespace slamgw
