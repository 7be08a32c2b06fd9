// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/session_names.hpp"

#include <algorithm>

namespace slamgw::sessions {

SessionNames::SessionNames(const TopicScheme& scheme)
    : client_id_root_(scheme.prefix() + "-robot-"),
      note_root_(scheme.prefix() + "/fleet/robots/"),
      command_root_(scheme.command_root()) {
  std::ranges::replace(client_id_root_, '/', '-');
}

std::string SessionNames::client_id(std::string_view robot) const {
  return client_id_root_ + std::string(robot);
}

std::string SessionNames::note_topic(std::string_view robot) const {
  return note_root_ + std::string(robot);
}

std::string SessionNames::mailbox_topic(std::string_view robot) const {
  return note_topic(robot) + "/waiting";
}

std::string SessionNames::command_filter(std::string_view robot) const {
  return command_root_ + std::string(robot) + "/#";
}

}  // namespace slamgw::sessions
