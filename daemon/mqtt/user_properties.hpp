// SPDX-License-Identifier: Apache-2.0
// The MQTT 5 user properties (section 3.3.2.3.7) that say where a robot's message came from:
// `mesh`, `gateway` and `received_at`; and the sender of a command: `sender`. Pure.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

/// Names and values, in their order.
using UserProperties = std::vector<std::pair<std::string, std::string>>;

inline constexpr std::string_view mesh_property = "mesh";
inline constexpr std::string_view gateway_property = "gateway";
inline constexpr std::string_view received_at_property = "received_at";
/// The name that the sender of a command gives itself, for the audit trail.
inline constexpr std::string_view sender_property = "sender";
/// Length of the value of `received_at`: ISO 8601 with milliseconds.
inline constexpr std::size_t received_at_bytes = 24;

/// Returns the size of the properties on the wire. Each has an identifier and two lengths (MQTT 5
/// section 3.3.2.3.7).
inline std::size_t user_property_bytes(const BrokerMessage& message,
                                       const std::string& gateway_id) {
  constexpr std::size_t frame = 1 + 2 + 2;
  if (message.sender) return frame + sender_property.size() + message.sender->who.size();
  if (!message.provenance) return 0;
  return 3 * frame + mesh_property.size() + to_string(message.provenance->mesh).size() +
         gateway_property.size() + gateway_id.size() + received_at_property.size() +
         received_at_bytes;
}

/// Returns the name that the sender of a command gives itself; null when it gives none.
inline Sender sender_of(const UserProperties& said) {
  for (const auto& [name, value] : said)
    if (name == sender_property) return sender_at_broker(value);
  return nullptr;
}

}  // namespace slamgw
