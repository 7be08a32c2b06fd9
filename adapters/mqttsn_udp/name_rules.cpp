// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/name_rules.hpp"

#include <algorithm>

namespace slamgw::mqttsn {

PredefinedTopics::PredefinedTopics(const std::vector<PredefinedTopic>& topics) {
  for (const PredefinedTopic& topic : topics)
    topics_[topic.id].emplace(topic.client_id.value_or(""), topic.name);
}

const std::string* PredefinedTopics::name_of(std::string_view client_id, std::uint16_t id) const {
  const auto topic = topics_.find(id);
  if (topic == topics_.end()) return nullptr;
  const ByClient& by_client = topic->second;
  if (const auto own = by_client.find(client_id); own != by_client.end()) return &own->second;
  const auto common = by_client.find(std::string_view());
  return common == by_client.end() ? nullptr : &common->second;
}

std::string short_name(std::uint16_t topic_id) {
  return {static_cast<char>(topic_id >> 8), static_cast<char>(topic_id & 0xff)};
}

bool is_short_name(std::string_view name) { return name.size() == 2 && !has_wildcard(name); }

std::uint16_t short_name_id(std::string_view name) {
  if (!is_short_name(name)) return 0;
  return static_cast<std::uint16_t>(static_cast<unsigned char>(name[0]) << 8 |
                                    static_cast<unsigned char>(name[1]));
}

/// A client that the configuration names may have an address on another mesh, too. Other clients
/// must not use the name of a robot there.
std::optional<std::string> NameRules::robot_of(const std::string& client_id) const {
  if (!is_valid_level(client_id)) return std::nullopt;
  auto robot = names.of_client(client_id);
  if (!robot || !is_valid_level(*robot)) return std::nullopt;
  const bool is_configured =
      std::ranges::count(names.configured(), client_id, &RobotName::mqttsn_client_id) > 0;
  if (!is_configured && is_elsewhere && is_elsewhere(*robot)) return std::nullopt;
  return robot;
}

std::string NameRules::client_of(const std::string& robot) const {
  const auto known = std::ranges::find(names.configured(), robot, &RobotName::id);
  return known != names.configured().end() ? known->mqttsn_client_id.value_or(robot) : robot;
}

}  // namespace slamgw::mqttsn
