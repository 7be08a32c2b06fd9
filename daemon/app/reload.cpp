// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/reload.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>

#include "daemon/config/rules.hpp"

namespace slamgw {
namespace {

/// Adds a key that differs to a list for people.
void note(std::string& keys, bool is_same, std::string_view key) {
  if (!is_same) keys += fmt::format("{}{}", keys.empty() ? "" : ", ", key);
}

/// Takes a setting that differs, and adds its key to the list.
template <class Setting>
void take(std::string& keys, Setting& now, Setting& wanted, std::string_view key) {
  note(keys, now == wanted, key);
  now = std::move(wanted);
}

std::string keys_for_restart(const Config& now, const Config& wanted) {
  std::string keys;
  note(keys, now.gateway_id == wanted.gateway_id, "gateway.id");
  note(keys, now.broker.max_inflight == wanted.broker.max_inflight, "broker.max_inflight");
  note(keys, now.topics.prefix == wanted.topics.prefix, "topics.prefix");
  note(keys, now.update_mode == wanted.update_mode, "payload.update");
  note(keys, now.topics.retain == wanted.topics.retain, "topics.retain");
  note(keys, now.ble_mesh == wanted.ble_mesh, "ble_mesh.* or presence.*");
  note(keys, now.mqttsn == wanted.mqttsn, "mqttsn.*");
  note(keys, now.store == wanted.store, "store.*");
  note(keys, now.control_socket == wanted.control_socket, "control.socket");
  return keys;
}

std::vector<std::string> default_names(const std::vector<RobotName>& robots) {
  const RobotNames unnamed;
  std::vector<std::string> names;
  for (const RobotName& robot : robots) {
    if (robot.ble_address) names.push_back(unnamed.of_ble(*robot.ble_address));
    if (robot.mqttsn_client_id) names.push_back(*robot.mqttsn_client_id);
  }
  return names;
}

std::vector<std::string> replaced_names(const std::vector<RobotName>& now,
                                        const std::vector<RobotName>& wanted) {
  std::vector<std::string> replaced = default_names(wanted);
  std::erase_if(replaced, [&](const std::string& name) {
    return std::ranges::count(default_names(now), name) > 0 ||
           std::ranges::count(wanted, name, &RobotName::id) > 0;
  });
  return replaced;
}

}  // namespace

Reload reload_of(const Config& now, Config wanted) {
  Reload reload{now, {}, keys_for_restart(now, wanted), replaced_names(now.robots, wanted.robots)};
  wanted.broker.gateway_id = now.broker.gateway_id;
  if (wanted.broker.client_id == default_client_id(wanted.gateway_id))
    wanted.broker.client_id = default_client_id(now.gateway_id);
  wanted.broker.max_inflight = now.broker.max_inflight;
  Config& config = reload.config;
  std::string& keys = reload.in_force;
  take(keys, config.log, wanted.log, "log");
  take(keys, config.robots, wanted.robots, "robots");
  take(keys, config.bans, wanted.bans, "bans");
  take(keys, config.robot_keys, wanted.robot_keys, "robots' keys");
  TopicSettings& topics = config.topics;
  take(keys, topics.extra_publish, wanted.topics.extra_publish, "topics.extra_publish");
  take(keys, topics.extra_subscribe, wanted.topics.extra_subscribe, "topics.extra_subscribe");
  take(keys, topics.home_assistant, wanted.topics.home_assistant, "topics.home_assistant");
  take(keys, config.broker, wanted.broker, "broker");
  take(reload.needs_restart, config.web, wanted.web,
       "web.* (type: sudo systemctl restart slam-gateway-web)");
  return reload;
}

nlohmann::ordered_json answer_json(const Reload& reload) {
  nlohmann::ordered_json answer{{"in_force", reload.in_force}};
  if (!reload.needs_restart.empty()) answer["needs_restart"] = reload.needs_restart;
  return answer;
}

}  // namespace slamgw
