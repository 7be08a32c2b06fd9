// SPDX-License-Identifier: Apache-2.0
// A broker's limits from its CONNACK (MQTT 5 section 3.2.2.3). MQTT 3.1.1 has none there, so the
// defaults hold. The gateway never uses topic aliases, and so keeps to their maximum.
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
  bool takes_wildcards = true;  ///< in subscriptions
  bool takes_subscription_ids = true;
  bool operator==(const BrokerLimits&) const = default;
};

/// Names the limits that an operator should know; empty when there are none.
std::string to_words(const BrokerLimits& limits);

/// Returns the size of a PUBLISH on the wire. `property_bytes`: of its MQTT 5 properties; nothing
/// with MQTT 3.1.1, which has no such field.
std::size_t publish_packet_bytes(const BrokerMessage& message,
                                 std::optional<std::size_t> property_bytes);

}  // namespace slamgw
