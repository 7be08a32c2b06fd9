// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/fleet_topics.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw::fleet {
namespace {

/// Cuts `head` off; false when `text` begins with something else.
bool cut(std::string_view& text, std::string_view head) {
  if (!text.starts_with(head)) return false;
  text.remove_prefix(head.size());
  return true;
}

}  // namespace

FleetTopics::FleetTopics(const std::string& prefix, std::string gateway)
    : gateway_(std::move(gateway)),
      root_(prefix + "/fleet/"),
      gateways_(prefix + "/gateway/"),
      commands_(prefix + "/server/") {}

std::string FleetTopics::rights() const {
  return fmt::format("topic write {0}all/{1}, topic write {0}to/+/{1}, topic read {0}#", root_,
                     gateway_);
}

std::optional<std::string_view> FleetTopics::sender(std::string_view topic) const {
  if (!cut(topic, root_)) return std::nullopt;
  const bool is_ours = cut(topic, "all/") || (cut(topic, "to/") && cut(topic, gateway_ + "/"));
  if (!is_ours || !is_valid_level(topic)) return std::nullopt;
  return topic;
}

std::optional<std::string_view> FleetTopics::gateway_of_state(std::string_view topic) const {
  if (!cut(topic, gateways_) || !topic.ends_with("/state")) return std::nullopt;
  topic.remove_suffix(std::string_view("/state").size());
  if (!is_valid_level(topic)) return std::nullopt;
  return topic;
}

std::optional<FleetTopics::Outcome> FleetTopics::outcome(std::string_view topic) const {
  constexpr std::string_view middle = "/commands/";
  if (!cut(topic, gateways_)) return std::nullopt;
  const std::size_t at = topic.find(middle);
  if (at == std::string_view::npos) return std::nullopt;
  const Outcome outcome{topic.substr(0, at), topic.substr(at + middle.size())};
  if (!is_valid_level(outcome.gateway) || !is_valid_level(outcome.robot)) return std::nullopt;
  return outcome;
}

}  // namespace slamgw::fleet
