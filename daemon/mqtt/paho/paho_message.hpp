// SPDX-License-Identifier: Apache-2.0
// From our values to Paho's and back. Pure; called by PahoLink.
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

/// Messages as Paho takes them, with the user properties `mesh`, `gateway` and `received_at` where
/// the version has such and a robot said it. Paho copies what it publishes, so one form is filled
/// in again for each: making the properties anew would cost more than all the rest, for Paho keeps
/// a record of each string that it allocates. To be made and destroyed while there is a client.
class PublishForm {
 public:
  PublishForm(MqttVersion version, const std::string& gateway_id);

  /// Good until the next call; to be read on the same thread only.
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
/// Of a CONNACK.
BrokerLimits limits_of(const mqtt::token& token, MqttVersion version);

/// The reason code (0x80 and up) with which the broker has refused what `token` stands for. Nothing
/// when it has refused nothing: then the connection is lost, or a request was not made. Paho gives
/// everything that fails with MQTT 3.1.1 the pseudo code 255 (MQTTPP_V3_CODE), which is no refusal;
/// of that version only a SUBACK can refuse (with 0x80).
std::optional<int> refusal_of(const mqtt::token& token);

/// `host` is a literal address or a name.
std::string server_uri(const BrokerSettings& settings, const std::string& host);

}  // namespace slamgw
