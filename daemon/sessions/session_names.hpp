// SPDX-License-Identifier: Apache-2.0
// The names of one robot's session at the broker, and the format of its mailbox's messages
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
  /// Topic of the retained note, from which the next gateway continues the robot's MQTT-SN session.
  std::string note_topic(std::string_view robot) const;
  /// Topic of messages that one gateway hands to the next; only the robot's session subscribes.
  std::string mailbox_topic(std::string_view robot) const;
  /// Matches all commands for the robot: `<prefix>/server/<robot>/#`.
  std::string command_filter(std::string_view robot) const;

 private:
  std::string client_id_root_;
  std::string note_root_;
  std::string command_root_;
};

/// Encodes a message that one gateway hands to the next: age in milliseconds (4 octets), QoS (1),
/// length of the topic (2), topic, payload. Numbers are big-endian.
Bytes encode_waiting(const WaitingMessage& waiting);
/// Decodes encode_waiting(); `waited` of the message is its age. Returns nothing when the octets
/// are not such a message.
std::optional<BrokerMessage> decode_waiting(ByteView octets);

}  // namespace slamgw::sessions
