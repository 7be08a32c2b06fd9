// SPDX-License-Identifier: Apache-2.0
// Which settings of a reloaded configuration take effect at once.
#include "daemon/app/reload.hpp"

#include <nlohmann/json.hpp>

#include <gtest/gtest.h>

namespace slamgw {
namespace {

TEST(Reload, AppliesSettingsThatNeedNoRestart) {
  Config wanted;
  wanted.log.level = Severity::debug;
  wanted.broker.host = "elsewhere";
  wanted.robots = {{"r", 0x0100, {}}};
  wanted.topics.extra_publish = {"lab/#"};
  wanted.topics.home_assistant = true;
  const Reload reload = reload_of(Config{}, wanted);
  EXPECT_EQ(reload.config.log.level, Severity::debug);
  EXPECT_EQ(reload.config.broker.host, "elsewhere");
  EXPECT_EQ(reload.config.robots, wanted.robots);
  EXPECT_EQ(reload.config.topics.extra_publish, wanted.topics.extra_publish);
  EXPECT_TRUE(reload.needs_restart.empty());
  EXPECT_TRUE(reload.config.topics.home_assistant);
  EXPECT_EQ(reload.in_force, "log, robots, topics.extra_publish, topics.home_assistant, broker")
      << "only what differs";
  EXPECT_EQ(reload_of(wanted, wanted).in_force, "");
}

TEST(Reload, KeepsDefaultClientIdThatAnotherGatewayMayUse) {
  Config now;
  now.gateway_id = now.broker.gateway_id = "here";
  now.broker.client_id = "slam-gateway-here";
  Config wanted = now;
  wanted.gateway_id = wanted.broker.gateway_id = "other";
  wanted.broker.client_id = "slam-gateway-other";
  const Reload reload = reload_of(now, wanted);
  EXPECT_EQ(reload.config.broker.client_id, "slam-gateway-here");
  EXPECT_EQ(reload.in_force, "");
  EXPECT_EQ(reload.needs_restart, "gateway.id");
  wanted.broker.client_id = "mine";
  EXPECT_EQ(reload_of(now, wanted).config.broker.client_id, "mine");
}

TEST(Reload, NamesSettingsThatNeedRestartAndKeepsThem) {
  Config now;
  now.broker.max_inflight = 16;
  Config wanted = now;
  wanted.gateway_id = "other";
  wanted.broker.gateway_id = "other";
  wanted.broker.max_inflight = 17;
  wanted.topics.prefix = "other";
  wanted.update_mode = UpdateMode::json;
  wanted.ble_mesh.enabled = !now.ble_mesh.enabled;
  wanted.mqttsn.gateway_id = 9;
  wanted.store.max_bytes = 1;
  wanted.control_socket = "/other";
  const Reload reload = reload_of(now, wanted);
  EXPECT_EQ(reload.needs_restart,
            "gateway.id, broker.max_inflight, topics.prefix, payload.update, "
            "ble_mesh.* or presence.*, mqttsn.*, store.*, control.socket");
  const auto answer = answer_json(reload);
  EXPECT_EQ(answer["needs_restart"], reload.needs_restart);
  EXPECT_EQ(answer["in_force"], "") << "a setting that needs a restart is not in force";
  EXPECT_EQ(reload.config.broker.max_inflight, 16);
  EXPECT_EQ(reload.config.broker.gateway_id, now.broker.gateway_id);
  EXPECT_EQ(reload.config.topics.prefix, now.topics.prefix);
}

TEST(Reload, NamesServiceThatReadsChangedKeysOfPageOnce) {
  Config wanted;
  wanted.web.hosts = {"slam.example.org"};
  const Reload reload = reload_of(Config(), wanted);
  EXPECT_EQ(reload.in_force, "");
  EXPECT_EQ(reload.needs_restart, "web.* (type: sudo systemctl restart slam-gateway-web)");
  EXPECT_EQ(reload_of(reload.config, wanted).needs_restart, "")
      << "no start of the daemon reads it";
}

TEST(Reload, AppliesRobotKeysAtOnce) {
  Config wanted;
  wanted.robot_keys["r1"] = Bytes(16, 1);
  const Reload reload = reload_of(Config(), wanted);
  EXPECT_EQ(reload.config.robot_keys, wanted.robot_keys);
  EXPECT_EQ(reload.needs_restart, "");
}

TEST(Reload, NamesDefaultNamesThatNoRobotHasAnyMore) {
  Config now;
  now.robots = {{"lego", 0x0100, "nrf-1"}};
  Config wanted;
  wanted.robots = {{"tank", 0x0100, "nrf-1"}, {"nrf-3", 0x0101, "nrf-2"}, {"c", {}, "nrf-3"}};
  EXPECT_EQ(reload_of(now, wanted).replaced_names, (std::vector<std::string>{"ble-0101", "nrf-2"}))
      << "nrf-1 and ble-0100 had a name before; nrf-3 names a robot now";
}

}  // namespace
}  // namespace slamgw
