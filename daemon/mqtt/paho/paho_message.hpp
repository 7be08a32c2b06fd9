// SPDX-License-Identifier: Apache-2.0
// Converts the daemon's values to Paho's and back. Pure; called by PahoLink.
#pragma once

#include <mqtt/message.h>
#include <mqtt/token.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/mqtt/broker_limits.hpp"
#include "daemon/mqtt/settings.hpp"
#include "daemon/mqtt/user_properties.hpp"
#include "daemon/mqtt/version_choice.hpp"

namespace slamgw {

/// Messages in Paho's form. A robot's message has the user properties `mesh`, `gateway` and
/// `received_at` with MQTT 5. Paho copies what it publishes, so one form is filled in again for
/// each message. New properties would cost more than all the rest, because Paho keeps a record of
/// each string that it allocates. Make and destroy the form while there is a client.
class PublishForm {
 public:
  PublishForm(MqttVersion version, const std::string& gateway_id);

  /// Returns the form, valid until the next call; read it on the same thread only.
  mqtt::const_message_ptr fill(const BrokerMessage& message);

 private:
  const std::shared_ptr<mqtt::message>& form_of(const BrokerMessage& message) const;
  static void write_time(mqtt::message& form, WallTime time);

  MqttVersion version_;
  PerMesh<std::shared_ptr<mqtt::message>> forms_;
  std::shared_ptr<mqtt::message> form_without_provenance_;
};

BrokerMessage from_paho(const mqtt::message& message);
UserProperties user_properties_of(const mqtt::message& message);
/// Returns the limits in a CONNACK.
BrokerLimits limits_of(const mqtt::token& token, MqttVersion version);

/// Returns the reason code (0x80 and up) with which the broker has refused the request of `token`;
/// nothing when it has not. Then a failed request was not made, or its connection was lost. With
/// MQTT 3.1.1, Paho gives all failures the pseudo code 255 (MQTTPP_V3_CODE), which is not a
/// refusal; only a SUBACK can refuse there (with 0x80).
std::optional<int> refusal_of(const mqtt::token& token);

/// `host` is a literal address or a name.
std::string server_uri(const BrokerSettings& settings, const std::string& host);

}  // namespace slamgw
