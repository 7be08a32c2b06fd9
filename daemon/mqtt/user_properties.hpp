// SPDX-License-Identifier: Apache-2.0
// The MQTT 5 user properties that say where a robot's message came from: `mesh`, `gateway` and
// `received_at`. Pure.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "daemon/core/messages.hpp"

namespace slamgw {

inline constexpr std::string_view mesh_property = "mesh";
inline constexpr std::string_view gateway_property = "gateway";
inline constexpr std::string_view received_at_property = "received_at";
/// Of a command: what its sender calls itself, for the audit trail.
inline constexpr std::string_view sender_property = "sender";
/// Places of the value of `received_at`: ISO 8601 with milliseconds.
inline constexpr std::size_t received_at_bytes = 24;

/// What they take on the wire: for each an identifier and two lengths (MQTT 5 section 3.3.2.3.7).
inline std::size_t user_property_bytes(const BrokerMessage& message,
                                       const std::string& gateway_id) {
  if (!message.provenance) return 0;
  constexpr std::size_t frame = 1 + 2 + 2;
  return 3 * frame + mesh_property.size() + to_string(message.provenance->mesh).size() +
         gateway_property.size() + gateway_id.size() + received_at_property.size() +
         received_at_bytes;
}

}  // namespace slamgw
