// SPDX-License-Identifier: Apache-2.0
// From our values to Paho's and back. Pure; called by PahoSession.
#pragma once

#include <mqtt/message.h>
#include <mqtt/token.h>

#include <cstdint>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/upstream/settings.hpp"

namespace slamgw {

enum class MqttVersion : std::uint8_t { v3_1_1 = 4, v5 = 5 };

/// With the user properties `mesh`, `gateway` and `received_at` where the version has such and a
/// robot said it.
mqtt::const_message_ptr to_paho(const BrokerMessage& message, MqttVersion version,
                                const std::string& gateway_id);
BrokerMessage from_paho(const mqtt::message& message);
/// MQTT 5 section 3.3.2.3.8; empty with MQTT 3.1.1.
std::vector<std::uint32_t> subscriptions_of(const mqtt::message& message);
/// Of a CONNACK; 65535 where it names none.
std::uint16_t receive_maximum_of(const mqtt::token& token, MqttVersion version);

/// `host` is a literal address or a name.
std::string server_uri(const BrokerSettings& settings, const std::string& host);

}  // namespace slamgw
