// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/reload.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>

namespace slamgw {
namespace {

/// Adds a key that differs to a list for people.
void note(std::string& keys, bool is_same, std::string_view key) {
  if (!is_same) keys += fmt::format("{}{}", keys.empty() ? "" : ", ", key);
}

/// Returns `wanted` with the present values of the settings that only a restart changes.
BrokerSettings broker_at_once(const BrokerSettings& now, BrokerSettings wanted) {
  wanted.gateway_id = now.gateway_id;
  wanted.max_inflight = now.max_inflight;
  return wanted;
}

std::string keys_in_force(const Config& now, const Config& wanted) {
  std::string keys;
  note(keys, now.log == wanted.log, "log");
  note(keys, now.robots == wanted.robots, "robots");
  note(keys, now.bans == wanted.bans, "bans");
  note(keys, now.robot_keys == wanted.robot_keys, "robots' keys");
  note(keys, now.topics.extra_publish == wanted.topics.extra_publish, "topics.extra_publish");
  note(keys, now.topics.extra_subscribe == wanted.topics.extra_subscribe, "topics.extra_subscribe");
  note(keys, now.topics.home_assistant == wanted.topics.home_assistant, "topics.home_assistant");
  note(keys, now.broker == broker_at_once(now.broker, wanted.broker), "broker");
  return keys;
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
  Reload reload{now,
                keys_in_force(now, wanted),
                now.robots != wanted.robots || now.bans != wanted.bans,
                now.topics.extra_publish != wanted.topics.extra_publish ||
                    now.topics.extra_subscribe != wanted.topics.extra_subscribe,
                keys_for_restart(now, wanted),
                replaced_names(now.robots, wanted.robots),
                now.robot_keys != wanted.robot_keys};
  Config& config = reload.config;
  config.log = wanted.log;
  config.robots = std::move(wanted.robots);
  config.bans = std::move(wanted.bans);
  config.robot_keys = std::move(wanted.robot_keys);
  config.topics.extra_publish = std::move(wanted.topics.extra_publish);
  config.topics.extra_subscribe = std::move(wanted.topics.extra_subscribe);
  config.topics.home_assistant = wanted.topics.home_assistant;
  config.broker = broker_at_once(now.broker, std::move(wanted.broker));
  return reload;
}

nlohmann::ordered_json answer_json(const Reload& reload) {
  nlohmann::ordered_json answer{{"in_force", reload.in_force}};
  if (!reload.needs_restart.empty()) answer["needs_restart"] = reload.needs_restart;
  return answer;
}

}  // namespace slamgw
