// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/topic_scheme.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/algorithm/string/replace.hpp>
#include <utility>

#include "daemon/core/utf8.hpp"

namespace slamgw {
namespace {

constexpr std::size_t max_level_bytes = 64;
/// Mosquitto closes the connection for a topic with more than 201 levels.
constexpr std::ptrdiff_t max_levels = 200;

bool has(std::string_view text, char c) { return text.find(c) != std::string_view::npos; }

/// The level up to the next `/`; `rest` is what follows it, or nothing at the last level.
struct Split {
  std::string_view level;
  std::optional<std::string_view> rest;
};

Split first_level(std::string_view topic) {
  const std::size_t slash = topic.find('/');
  if (slash == std::string_view::npos) return {topic, std::nullopt};
  return {topic.substr(0, slash), topic.substr(slash + 1)};
}

bool is_topic_text(std::string_view text) {
  return !text.empty() && std::count(text.begin(), text.end(), '/') < max_levels &&
         is_mqtt_text(text);
}

/// Returns nothing for a topic that is not below `root`, or whose first level there is invalid.
std::optional<Split> split_below(std::string_view root, std::string_view topic) {
  if (!topic.starts_with(root)) return std::nullopt;
  const Split split = first_level(topic.substr(root.size()));
  return is_valid_level(split.level) ? std::optional(split) : std::nullopt;
}

std::optional<TopicScheme::RobotAndType> parse_below(std::string_view root,
                                                     std::string_view topic) {
  const auto robot = split_below(root, topic);
  if (!robot || !robot->rest || !is_valid_level(*robot->rest)) return std::nullopt;
  return TopicScheme::RobotAndType{robot->level, *robot->rest};
}

/// Returns a filter that matches nothing if a client id would make it one of the broker's own
/// topics, a shared subscription, or one of the gateway's own topics.
std::string with_client_id(const std::string& filter, std::string_view client_id,
                           std::string_view prefix) {
  std::string own = boost::algorithm::replace_all_copy(filter, "%c", client_id);
  const bool is_named_by_client = first_level(filter).level.find("%c") != std::string_view::npos;
  const std::string_view level = first_level(own).level;
  if (is_named_by_client && (level.starts_with('$') || level == first_level(prefix).level))
    return {};
  return own;
}

/// True when every topic that `inner` can match is matched by `outer`. A leading wildcard does not
/// reach topics that begin with `$` (MQTT 5 section 4.7.2), nor shared subscriptions.
bool filter_covers(std::string_view outer, std::string_view inner) {
  if (inner.starts_with('$') && (outer.starts_with('+') || outer.starts_with('#'))) return false;
  while (true) {
    const Split o = first_level(outer);
    const Split i = first_level(inner);
    if (o.level == "#") return true;
    if (i.level == "#" || (o.level != "+" && o.level != i.level)) return false;
    if (!o.rest && !i.rest) return true;
    if (o.rest == "#" && !i.rest) return true;  // "a/#" also matches "a"
    if (!o.rest || !i.rest) return false;
    outer = *o.rest;
    inner = *i.rest;
  }
}

}  // namespace

bool is_valid_level(std::string_view level) {
  return !level.empty() && level.size() <= max_level_bytes && is_mqtt_text(level) &&
         !has_wildcard(level) && !has(level, '/');
}

bool has_wildcard(std::string_view filter) {
  // Not find_first_of(): it searches the list of characters once for each octet.
  return has(filter, '+') || has(filter, '#');
}

bool is_valid_topic_name(std::string_view topic) {
  return is_topic_text(topic) && !has_wildcard(topic);
}

bool is_valid_filter(std::string_view filter) {
  if (!is_topic_text(filter)) return false;
  for (std::optional<std::string_view> rest = filter; rest;) {
    const Split split = first_level(*rest);
    if (has_wildcard(split.level) && split.level != "+" && split.level != "#") return false;
    if (split.level == "#" && split.rest) return false;
    rest = split.rest;
  }
  return true;
}

bool filter_matches(std::string_view filter, std::string_view topic) {
  return filter_covers(filter, topic);
}

TopicScheme::TopicScheme(std::string prefix, std::string gateway_id)
    : prefix_(std::move(prefix)),
      gateway_id_(std::move(gateway_id)),
      robot_root_(prefix_ + "/robot/"),
      command_root_(prefix_ + "/server/"),
      gateways_root_(prefix_ + "/gateway/"),
      gateway_root_(gateways_root_ + gateway_id_ + "/"),
      hears_root_(prefix_ + "/fleet/all/") {}

std::string TopicScheme::robot_topic(std::string_view robot, std::string_view type) const {
  return fmt::format("{}{}/{}", robot_root_, robot, type);
}

std::string TopicScheme::command_topic(std::string_view robot, std::string_view type) const {
  return fmt::format("{}{}/{}", command_root_, robot, type);
}

std::string TopicScheme::command_filter(std::string_view robot) const {
  return command_topic(robot, "+");
}

std::optional<TopicScheme::RobotAndType> TopicScheme::parse_robot_topic(
    std::string_view topic) const {
  return parse_below(robot_root_, topic);
}

std::optional<TopicScheme::RobotAndType> TopicScheme::parse_command_topic(
    std::string_view topic) const {
  return parse_below(command_root_, topic);
}

std::optional<TopicScheme::GatewayAndRobot> TopicScheme::parse_presence_topic(
    std::string_view topic) const {
  const auto gateway = split_below(gateways_root_, topic);
  if (!gateway || !gateway->rest) return std::nullopt;
  const Split what = first_level(*gateway->rest);
  if (what.level != "robots" || !what.rest || !is_valid_level(*what.rest)) return std::nullopt;
  return GatewayAndRobot{gateway->level, *what.rest};
}

std::optional<std::string_view> TopicScheme::gateway_of_state(std::string_view topic) const {
  const auto gateway = split_below(gateways_root_, topic);
  if (!gateway || gateway->rest != "state") return std::nullopt;
  return gateway->level;
}

std::optional<std::string_view> TopicScheme::gateway_of_hears(std::string_view topic) const {
  const auto gateway = split_below(hears_root_, topic);
  if (!gateway || gateway->rest) return std::nullopt;
  return gateway->level;
}

std::string TopicScheme::presence_topic(std::string_view robot) const {
  return fmt::format("{}robots/{}", gateway_root_, robot);
}

std::string TopicScheme::presence_topic_at(const std::string& gateway,
                                           std::string_view robot) const {
  return fmt::format("{}{}/robots/{}", gateways_root_, gateway, robot);
}

std::string TopicScheme::outcome_topic(std::string_view robot) const {
  return fmt::format("{}commands/{}", gateway_root_, robot);
}

std::string TopicScheme::rejected_topic(std::string_view robot, std::string_view type) const {
  return fmt::format("{}rejected/{}/{}", gateway_root_, robot, type);
}

TopicPolicy::TopicPolicy(TopicScheme scheme, std::vector<std::string> extra_publish,
                         std::vector<std::string> extra_subscribe)
    : scheme_(std::move(scheme)),
      extra_publish_(std::move(extra_publish)),
      extra_subscribe_(std::move(extra_subscribe)) {}

bool TopicPolicy::may_publish(std::string_view client_id, std::string_view robot,
                              std::string_view topic) const {
  const auto own = scheme_.parse_robot_topic(topic);
  if (own && own->robot == robot) return true;
  return std::any_of(extra_publish_.begin(), extra_publish_.end(), [&](const std::string& filter) {
    return filter_matches(with_client_id(filter, client_id, scheme_.prefix()), topic);
  });
}

bool TopicPolicy::may_subscribe(std::string_view client_id, std::string_view robot,
                                std::string_view filter) const {
  const std::string own_commands = scheme_.command_root() + std::string(robot) + "/";
  if (filter.size() > own_commands.size() && filter.starts_with(own_commands)) return true;
  if (filter.size() > scheme_.robot_root().size() && filter.starts_with(scheme_.robot_root()))
    return true;
  return std::any_of(
      extra_subscribe_.begin(), extra_subscribe_.end(), [&](const std::string& extra) {
        return filter_covers(with_client_id(extra, client_id, scheme_.prefix()), filter);
      });
}

}  // namespace slamgw
