// SPDX-License-Identifier: Apache-2.0
// The names at the broker that belong to one robot's session, and what its mailbox holds
// (docs/fleet.md). Pure functions.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "daemon/core/messages.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::sessions {

class SessionNames {
 public:
  explicit SessionNames(const TopicScheme& scheme);

  /// `<prefix with "/" as "-">-robot-<robot>`.
  std::string client_id(std::string_view robot) const;
  /// Retained: what the next gateway needs of the robot's MQTT-SN session.
  std::string note_topic(std::string_view robot) const;
  /// What one gateway hands to the next: only the robot's session subscribes to it.
  std::string mailbox_topic(std::string_view robot) const;
  /// Everything that is said to the robot: `<prefix>/server/<robot>/#`.
  std::string command_filter(std::string_view robot) const;

 private:
  std::string client_id_root_;
  std::string note_root_;
  std::string command_root_;
};

/// What one gateway hands to the next for a robot: a big-endian age in milliseconds (4 octets), the
/// QoS (1), the length of the topic (2), the topic, and the payload.
Bytes encode_waiting(const WaitingMessage& waiting);
/// `waited` of the message is its age. Nothing when the octets are no such message.
std::optional<BrokerMessage> decode_waiting(ByteView octets);

}  // namespace slamgw::sessions
