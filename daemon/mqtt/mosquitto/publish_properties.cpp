// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/mosquitto/publish_properties.hpp"

#include <mqtt_protocol.h>

#include <cstdlib>

namespace slamgw {

const mosquitto_property* PublishProperties::of(const BrokerMessage& message) {
  if (version_ != MqttVersion::v5) return nullptr;
  if (message.sender) {
    provenance_in_list_.reset();
    clear();
    add(sender_property, message.sender->who);
    return list_;
  }
  if (!message.provenance) return nullptr;
  const WallTime to_the_ms =
      std::chrono::floor<std::chrono::milliseconds>(message.provenance->received_at);
  const Provenance said{message.provenance->mesh, to_the_ms};
  if (provenance_in_list_ && provenance_in_list_->mesh == said.mesh &&
      provenance_in_list_->received_at == said.received_at)
    return list_;
  provenance_in_list_ = said;
  clear();
  add(mesh_property, std::string(to_string(message.provenance->mesh)));
  add(gateway_property, gateway_id_);
  add(received_at_property, to_iso8601_ms(message.provenance->received_at));
  return list_;
}

void PublishProperties::add(std::string_view name, const std::string& value) {
  mosquitto_property_add_string_pair(&list_, MQTT_PROP_USER_PROPERTY, name.data(), value.c_str());
}

BrokerLimits limits_of(const mosquitto_property* connack) {
  BrokerLimits limits;
  std::uint32_t number = 0;
  std::uint8_t octet = 0;
  mosquitto_property_read_int16(connack, MQTT_PROP_RECEIVE_MAXIMUM, &limits.receive_maximum, false);
  if (mosquitto_property_read_int32(connack, MQTT_PROP_MAXIMUM_PACKET_SIZE, &number, false))
    limits.max_packet_bytes = number;
  if (mosquitto_property_read_byte(connack, MQTT_PROP_MAXIMUM_QOS, &octet, false))
    limits.max_qos = static_cast<Qos>(octet);
  if (mosquitto_property_read_byte(connack, MQTT_PROP_RETAIN_AVAILABLE, &octet, false))
    limits.keeps_retained = octet != 0;
  if (mosquitto_property_read_byte(connack, MQTT_PROP_WILDCARD_SUB_AVAILABLE, &octet, false))
    limits.takes_wildcards = octet != 0;
  if (mosquitto_property_read_byte(connack, MQTT_PROP_SUBSCRIPTION_ID_AVAILABLE, &octet, false))
    limits.takes_subscription_ids = octet != 0;
  return limits;
}

std::vector<std::uint32_t> subscriptions_of(const mosquitto_property* publish) {
  std::vector<std::uint32_t> ids;
  std::uint32_t id = 0;
  const mosquitto_property* at = publish;
  while ((at = mosquitto_property_read_varint(at, MQTT_PROP_SUBSCRIPTION_IDENTIFIER, &id,
                                              !ids.empty())) != nullptr)
    ids.push_back(id);
  return ids;
}

UserProperties user_properties_of(const mosquitto_property* publish) {
  UserProperties said;
  char* name = nullptr;
  char* value = nullptr;
  const mosquitto_property* at = publish;
  while ((at = mosquitto_property_read_string_pair(at, MQTT_PROP_USER_PROPERTY, &name, &value,
                                                   !said.empty())) != nullptr) {
    said.emplace_back(name, value);
    std::free(name);
    std::free(value);
  }
  return said;
}

}  // namespace slamgw
