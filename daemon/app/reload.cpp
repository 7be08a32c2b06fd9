// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/reload.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>

namespace slamgw {
namespace {

std::string keys_for_restart(const Config& now, const Config& wanted) {
  std::string keys;
  const auto note = [&](bool is_same, std::string_view key) {
    if (!is_same) keys += fmt::format("{}{}", keys.empty() ? "" : ", ", key);
  };
  note(now.gateway_id == wanted.gateway_id, "gateway.id");
  note(now.broker.max_inflight == wanted.broker.max_inflight, "broker.max_inflight");
  note(now.topics.prefix == wanted.topics.prefix, "topics.prefix");
  note(now.update_mode == wanted.update_mode, "payload.update");
  note(now.topics.retain == wanted.topics.retain, "topics.retain");
  note(now.ble_mesh == wanted.ble_mesh, "ble_mesh.* or presence.*");
  note(now.mqttsn == wanted.mqttsn, "mqttsn.*");
  note(now.store == wanted.store, "store.*");
  note(now.control_socket == wanted.control_socket, "control.socket");
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
  config.broker = std::move(wanted.broker);
  config.broker.gateway_id = now.broker.gateway_id;
  config.broker.max_inflight = now.broker.max_inflight;
  return reload;
}

nlohmann::ordered_json answer_json(const Reload& reload) {
  nlohmann::ordered_json answer{
      {"in_force",
       "log, robots, bans, robots' keys, topics.extra_publish, topics.extra_subscribe, "
       "broker (except max_inflight)"}};
  if (!reload.needs_restart.empty()) answer["needs_restart"] = reload.needs_restart;
  return answer;
}

}  // namespace slamgw
