// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/own_names.hpp"

#include <algorithm>
#include <map>
#include <utility>

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

namespace {

/// Renames the filters. If the client has both names of a filter, the higher QoS counts.
void rename_filters(ClientSession& session, const NewName& new_name) {
  std::map<std::string, Subscription, std::less<>> renamed;
  for (const auto& [filter, subscription] : session.subscriptions) {
    const std::string name = new_name(filter).value_or(filter);
    Subscription& kept = renamed.try_emplace(name, subscription).first->second;
    kept.qos = std::max(kept.qos, subscription.qos);
  }
  session.subscriptions = std::move(renamed);
}

}  // namespace

void rename_topics(const TopicScheme& scheme, ClientSession& session, std::string_view from,
                   const std::string& to) {
  bool has_own = false;
  const auto new_name = [&](const std::string& topic) {
    auto own = replace_robot(scheme, topic, from, to);
    has_own |= own.has_value();
    return own;
  };
  session.topics.rename(new_name);
  rename_filters(session, new_name);
  session.delivery.rename(new_name);
  if (session.will)
    session.will->topic = new_name(session.will->topic).value_or(session.will->topic);
  if (from == session.client_id) session.uses_client_id = has_own;
}

}  // namespace slamgw::mqttsn
