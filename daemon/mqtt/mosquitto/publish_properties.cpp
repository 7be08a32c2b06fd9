// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/mosquitto/publish_properties.hpp"

#include <mqtt_protocol.h>

#include "daemon/mqtt/mosquitto/read_user_properties.hpp"
#include "daemon/mqtt/user_properties.hpp"

namespace slamgw {

const mosquitto_property* PublishProperties::of(const BrokerMessage& message) {
  if (version_ != MqttVersion::v5 || !message.provenance) return nullptr;
  const WallTime to_the_ms =
      std::chrono::floor<std::chrono::milliseconds>(message.provenance->received_at);
  const Provenance said{message.provenance->mesh, to_the_ms};
  if (list_ && provenance_in_list_->mesh == said.mesh &&
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

Sender sender_of(const mosquitto_property* publish) {
  Sender sender;
  read_user_properties(publish, [&](std::string_view name, std::string_view value) {
    if (!sender && name == sender_property) sender = sender_at_broker(value);
  });
  return sender;
}

}  // namespace slamgw
