// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/own_names.hpp"

namespace slamgw::mqttsn {

std::optional<std::string> replace_robot(const TopicScheme& scheme, std::string_view topic,
                                         std::string_view from, std::string_view to) {
  for (const std::string& root : {scheme.robot_root(), scheme.command_root()}) {
    if (!topic.starts_with(root)) continue;
    const std::string_view below = topic.substr(root.size());
    if (!below.starts_with(from) || below.substr(from.size(), 1) != "/") continue;
    return root + std::string(to) + std::string(below.substr(from.size()));
  }
  return std::nullopt;
}

std::string to_broker_name(const TopicScheme& scheme, ClientSession& session, std::string topic) {
  if (session.client_id == session.robot) return topic;
  auto own = replace_robot(scheme, topic, session.client_id, session.robot);
  if (!own) return topic;
  session.uses_client_id = true;
  return std::move(*own);
}

std::string to_client_name(const TopicScheme& scheme, const ClientSession& session,
                           const std::string& topic) {
  if (!session.uses_client_id) return topic;
  return replace_robot(scheme, topic, session.robot, session.client_id).value_or(topic);
}

}  // namespace slamgw::mqttsn
