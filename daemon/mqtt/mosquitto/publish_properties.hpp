// SPDX-License-Identifier: Apache-2.0
// Converts the properties of an MQTT 5 PUBLISH to libmosquitto's form, and those of a received
// CONNACK or PUBLISH to the daemon's.
#pragma once

#include <mosquitto.h>

#include <cstdint>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/mqtt/broker_limits.hpp"
#include "daemon/mqtt/user_properties.hpp"
#include "daemon/mqtt/version_choice.hpp"

namespace slamgw {

class PublishProperties {
 public:
  PublishProperties(MqttVersion version, std::string gateway_id)
      : version_(version), gateway_id_(std::move(gateway_id)) {}
  ~PublishProperties() { clear(); }
  PublishProperties(const PublishProperties&) = delete;
  PublishProperties& operator=(const PublishProperties&) = delete;

  /// Returns the properties of `message`, valid until the next call; null when there are none.
  const mosquitto_property* of(const BrokerMessage& message);

 private:
  void add(std::string_view name, const std::string& value);
  void clear() { mosquitto_property_free_all(&list_); }

  const MqttVersion version_;
  const std::string gateway_id_;
  mosquitto_property* list_ = nullptr;
  /// The provenance in `list_`, to the millisecond: many messages may have the same.
  std::optional<Provenance> provenance_in_list_;
};

BrokerLimits limits_of(const mosquitto_property* connack);
/// Returns the subscription identifiers (MQTT 5 section 3.3.2.3.8); none with MQTT 3.1.1.
std::vector<std::uint32_t> subscriptions_of(const mosquitto_property* publish);
/// Returns the user properties; none with MQTT 3.1.1.
UserProperties user_properties_of(const mosquitto_property* publish);

}  // namespace slamgw
