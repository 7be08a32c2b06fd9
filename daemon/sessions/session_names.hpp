// SPDX-License-Identifier: Apache-2.0
// The names at the broker that belong to one robot's session (docs/fleet.md). Pure functions on
// strings.
#pragma once

#include <string>
#include <string_view>

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

}  // namespace slamgw::sessions
