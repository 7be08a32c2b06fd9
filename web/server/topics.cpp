// SPDX-License-Identifier: Apache-2.0
#include "web/server/topics.hpp"

#include "daemon/core/topic_scheme.hpp"

namespace slamgw::web {

std::string_view Topics::below(std::string_view topic, std::string_view branch) const {
  if (!topic.starts_with(prefix_)) return {};
  topic.remove_prefix(prefix_.size());
  return topic.starts_with(branch) ? topic.substr(branch.size()) : std::string_view();
}

TopicKind Topics::kind_of(std::string_view topic) const {
  if (!below(topic, "/robot/").empty()) return TopicKind::robot;
  if (!below(topic, "/server/").empty()) return TopicKind::command;
  const std::string_view rest = gateway_topic(topic).rest;
  if (rest.empty()) return TopicKind::foreign;
  const bool is_newest_all = rest == "state" || rest == "stats" || rest == "numbers" ||
                             rest == "thread" || rest == join_response ||
                             rest.starts_with("robots/");
  return is_newest_all ? TopicKind::state : TopicKind::event;
}

Topics::GatewayTopic Topics::gateway_topic(std::string_view topic) const {
  const std::string_view levels = below(topic, "/gateway/");
  const std::size_t slash = levels.find('/');
  if (slash == levels.npos) return {};
  return {levels.substr(0, slash), levels.substr(slash + 1)};
}

std::string_view Topics::robot_of(std::string_view topic) const {
  const std::string_view levels = below(topic, "/robot/");
  return levels.substr(0, levels.find('/'));
}

bool Topics::may_publish(std::string_view topic) const {
  const auto [gateway, rest] = gateway_topic(topic);
  if (rest == "request/permit_join") return is_valid_level(gateway);
  return TopicScheme(prefix_, "").parse_command_topic(topic).has_value();
}

}  // namespace slamgw::web
