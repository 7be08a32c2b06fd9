// SPDX-License-Identifier: Apache-2.0
// What a broker takes, as its CONNACK says (MQTT 5 section 3.2.2.3). With MQTT 3.1.1 it says
// nothing, and these are the defaults. Topic aliases are never used, so its maximum is kept.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

struct BrokerLimits {
  std::uint16_t receive_maximum = 65535;          ///< unacknowledged publishes
  std::optional<std::uint32_t> max_packet_bytes;  ///< nothing: no limit
  Qos max_qos = Qos::exactly_once;
  bool keeps_retained = true;
  bool operator==(const BrokerLimits&) const = default;
};

/// What of them an operator should know; empty when there is nothing.
std::string to_words(const BrokerLimits& limits);

/// What a PUBLISH takes on the wire. `property_bytes`: of its MQTT 5 properties; nothing with MQTT
/// 3.1.1, where there is no such field.
std::size_t publish_packet_bytes(const BrokerMessage& message,
                                 std::optional<std::size_t> property_bytes);

}  // namespace slamgw
