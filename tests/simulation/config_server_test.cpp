// SPDX-License-Identifier: Apache-2.0
// The robot's configuration server byte for byte.
#include "simulation/ble/robot/config_server.hpp"

#include <gtest/gtest.h>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

class ConfigServerTest : public ::testing::Test {
 protected:
  ConfigServerTest() {
    configuration_.network.emplace();
    configuration_.network->address = 0x0100;
  }
  std::string ask(std::string_view message) {
    const ConfigServer::Result result = ConfigServer(configuration_).on_message(hex(message));
    was_reset_ = result.resets_node;
    return result.answer ? to_hex(*result.answer) : "";
  }
  void add_key() { ask("00 00 00 00 101112131415161718191a1b1c1d1e1f"); }

  NodeConfiguration configuration_;
  bool was_reset_ = false;
};

TEST_F(ConfigServerTest, TellsItsComposition) {
  const char* const page_0 =
      "02 00 59 00 01 00 01 00 28 00 01 00 00 00 03 06 00 00 02 00 00 10 "
      "59 00 00 00 59 00 04 00 59 00 05 00 59 00 06 00 59 00 08 00 59 00 09 00";
  EXPECT_EQ(ask("80 08 00"), page_0);
  EXPECT_EQ(ask("80 08 ff"), page_0);
  EXPECT_EQ(ask("80 08"), "");
}

TEST_F(ConfigServerTest, StoresApplicationKeys) {
  EXPECT_EQ(ask("00 00 00 00 101112131415161718191a1b1c1d1e1f"), "80 03 00 00 00 00");
  EXPECT_EQ(ask("00 00 00 00 101112131415161718191a1b1c1d1e1f"), "80 03 00 00 00 00");
  EXPECT_EQ(ask("00 00 00 00 ff1112131415161718191a1b1c1d1e1f"), "80 03 06 00 00 00");
  EXPECT_EQ(ask("00 23 61 45 101112131415161718191a1b1c1d1e1f"), "80 03 04 23 61 45");
  EXPECT_EQ(ask("00 00 60 45 101112131415161718191a1b1c1d1e1f"), "80 03 00 00 60 45");
  EXPECT_EQ(configuration_.app_keys[1].index, 0x456);
  EXPECT_EQ(ask("00 00 00 00 10"), "");
  for (int index = 2; index < 8; ++index) {
    ask("00 00 " + std::to_string(index) + "0 00 101112131415161718191a1b1c1d1e1f");
  }
  EXPECT_EQ(ask("00 00 90 00 101112131415161718191a1b1c1d1e1f"), "80 03 05 00 90 00");
}

TEST_F(ConfigServerTest, BindsKeysToModels) {
  EXPECT_EQ(ask("80 3d 00 01 00 00 59 00 06 00"), "80 3e 03 00 01 00 00 59 00 06 00");
  add_key();
  EXPECT_EQ(ask("80 3d 00 01 00 00 59 00 06 00"), "80 3e 00 00 01 00 00 59 00 06 00");
  EXPECT_EQ(ask("80 3d 00 01 00 00 59 00 06 00"), "80 3e 00 00 01 00 00 59 00 06 00");
  EXPECT_EQ(configuration_.find_model(sensor_update_client)->bindings.size(), 1U);
  EXPECT_EQ(ask("80 3d 00 01 00 00 00 10"), "80 3e 00 00 01 00 00 00 10");
  EXPECT_EQ(ask("80 3d 01 01 00 00 00 10"), "80 3e 01 01 01 00 00 00 10");
  EXPECT_EQ(ask("80 3d 00 01 00 00 59 00 77 00"), "80 3e 02 00 01 00 00 59 00 77 00");
  EXPECT_EQ(ask("80 3d 00 01 00 00 00 00"), "80 3e 0d 00 01 00 00 00 00");
  EXPECT_EQ(ask("80 3f 00 01 00 00 59 00 06 00"), "80 3e 00 00 01 00 00 59 00 06 00");
  EXPECT_TRUE(configuration_.find_model(sensor_update_client)->bindings.empty());
  EXPECT_EQ(ask("80 3d 00 01 00 00 59 00 06"), "");
}

TEST_F(ConfigServerTest, SetsPublications) {
  const char* const set = "03 00 01 01 00 00 00 04 00 00 59 00 06 00";
  EXPECT_EQ(ask(set), "80 19 03 00 01 00 00 00 00 00 00 00 59 00 06 00");
  add_key();
  EXPECT_EQ(ask(set), "80 19 00 00 01 01 00 00 00 04 00 00 59 00 06 00");
  EXPECT_EQ(ask("80 18 00 01 59 00 06 00"), "80 19 00 00 01 01 00 00 00 04 00 00 59 00 06 00");
  EXPECT_EQ(ask("03 00 01 01 00 00 10 ff 4a 05 02 00"),
            "80 19 00 00 01 01 00 00 10 ff 4a 05 02 00");
  const ModelPublication health = configuration_.find_model(health_server)->publication;
  EXPECT_EQ(health, (ModelPublication{0x0001, 0, true, 0xff, 0x4a, 0x05}));
  EXPECT_EQ(publish_period(health.period), std::chrono::seconds{10});
  EXPECT_EQ(ask("03 02 01 01 00 00 00 04 00 00 02 00"),
            "80 19 01 02 01 00 00 00 00 00 00 00 02 00");
  EXPECT_EQ(ask("03 00 01 01 00 00 00 04 00 00 03 00"),
            "80 19 02 00 01 00 00 00 00 00 00 00 03 00");
  EXPECT_EQ(ask("03 00 01 00 00 00 00 04 00 00 59 00 06 00"),
            "80 19 00 00 01 00 00 00 00 00 00 00 59 00 06 00");
  EXPECT_EQ(configuration_.find_model(sensor_update_client)->publication, ModelPublication{});
  EXPECT_EQ(ask("03 00 01 01 00 00 00 04 00 00 59"), "");
}

TEST_F(ConfigServerTest, KeepsSubscriptions) {
  EXPECT_EQ(ask("80 1b 00 01 04 c0 59 00 09 00"), "80 1f 00 00 01 04 c0 59 00 09 00");
  EXPECT_EQ(ask("80 1b 00 01 04 c0 59 00 09 00"), "80 1f 00 00 01 04 c0 59 00 09 00");
  EXPECT_EQ(configuration_.find_model(pos_cmd_server)->subscriptions, std::vector<Address>{0xc004});
  EXPECT_EQ(ask("80 1b 00 01 01 00 59 00 09 00"), "80 1f 01 00 01 01 00 59 00 09 00");
  EXPECT_EQ(ask("80 1b 00 01 ff ff 59 00 09 00"), "80 1f 01 00 01 ff ff 59 00 09 00");
  EXPECT_EQ(ask("80 1b 00 01 04 c0 59 00 0a 00"), "80 1f 02 00 01 04 c0 59 00 0a 00");
  EXPECT_EQ(ask("80 1b 00 01 04 c0 00 00"), "80 1f 08 00 01 04 c0 00 00");
  for (int i = 5; i < 12; ++i) {
    const std::string group{"0123456789ab"[i]};
    EXPECT_EQ(ask("80 1b 00 01 0" + group + "c0 59 00 09 00").substr(0, 8), "80 1f 00");
  }
  EXPECT_EQ(ask("80 1b 00 01 0c c0 59 00 09 00").substr(0, 8), "80 1f 05");
  EXPECT_EQ(ask("80 1c 00 01 04 c0 59 00 09 00"), "80 1f 00 00 01 04 c0 59 00 09 00");
  EXPECT_EQ(configuration_.find_model(pos_cmd_server)->subscriptions.size(), 7U);
}

TEST_F(ConfigServerTest, OverwritesSubscriptions) {
  const std::vector<Address>& groups = configuration_.find_model(pos_cmd_server)->subscriptions;
  EXPECT_EQ(ask("80 1e 00 01 02 c0 59 00 09 00"), "80 1f 00 00 01 02 c0 59 00 09 00");
  for (int i = 3; i < 10; ++i) ask("80 1b 00 01 0" + std::to_string(i) + "c0 59 00 09 00");
  ASSERT_EQ(groups.size(), NodeConfiguration::max_subscriptions);
  EXPECT_EQ(ask("80 1e 00 01 10 c0 59 00 09 00"), "80 1f 00 00 01 10 c0 59 00 09 00");
  EXPECT_EQ(groups, std::vector<Address>{0xc010});
  EXPECT_EQ(ask("80 1e 00 01 11 c0 00 10"), "80 1f 00 00 01 11 c0 00 10");
  EXPECT_EQ(configuration_.find_model(generic_on_off_server)->subscriptions,
            std::vector<Address>{0xc011});
  EXPECT_EQ(ask("80 1e 00 01 00 00 59 00 09 00"), "80 1f 01 00 01 00 00 59 00 09 00");
  EXPECT_EQ(ask("80 1e 00 01 ff ff 59 00 09 00"), "80 1f 01 00 01 ff ff 59 00 09 00");
  EXPECT_EQ(ask("80 1e 01 01 04 c0 59 00 09 00"), "80 1f 01 01 01 04 c0 59 00 09 00");
  EXPECT_EQ(ask("80 1e 00 01 04 c0 59 00 0a 00"), "80 1f 02 00 01 04 c0 59 00 0a 00");
  EXPECT_EQ(ask("80 1e 00 01 04 c0 00 00"), "80 1f 08 00 01 04 c0 00 00");
  EXPECT_EQ(ask("80 1e 00 01 04 c0 59"), "");
  EXPECT_EQ(groups, std::vector<Address>{0xc010});
}

/// The answers are those of Nordic's configuration server, release 3.1.0.
TEST_F(ConfigServerTest, ListsTheSubscriptionsOfAModel) {
  EXPECT_EQ(ask("80 2b 00 01 59 00 09 00"), "80 2c 00 00 01 59 00 09 00");
  ask("80 1b 00 01 02 c0 59 00 09 00");
  ask("80 1b 00 01 03 c0 59 00 09 00");
  ask("80 1b 00 01 02 c0 00 10");
  EXPECT_EQ(ask("80 2b 00 01 59 00 09 00"), "80 2c 00 00 01 59 00 09 00 02 c0 03 c0");
  EXPECT_EQ(ask("80 29 00 01 00 10"), "80 2a 00 00 01 00 10 02 c0");
  EXPECT_EQ(ask("80 2b 00 01 59 00 77 00"), "80 2c 02 00 01 59 00 77 00");
  EXPECT_EQ(ask("80 29 00 01 59 00 09 00"), "");
  EXPECT_EQ(ask("80 2b 00 01 00 10"), "");
}

TEST_F(ConfigServerTest, DeletesAllSubscriptionsOfAModel) {
  const std::vector<Address>& groups = configuration_.find_model(pos_cmd_server)->subscriptions;
  for (const char* group : {"02", "03"}) {
    ask("80 1b 00 01 " + std::string(group) + "c0 59 00 09 00");
    ask("80 1b 00 01 " + std::string(group) + "c0 00 10");
  }
  EXPECT_EQ(ask("80 1d 01 01 59 00 09 00"), "80 1f 01 01 01 00 00 59 00 09 00");
  EXPECT_EQ(ask("80 1d 00 01 59 00 0a 00"), "80 1f 02 00 01 00 00 59 00 0a 00");
  EXPECT_EQ(ask("80 1d 00 01 00 00"), "80 1f 08 00 01 00 00 00 00");
  EXPECT_EQ(ask("80 1d 00 01 02 c0 59 00 09 00"), "");
  EXPECT_EQ(groups.size(), 2U);
  EXPECT_EQ(ask("80 1d 00 01 59 00 09 00"), "80 1f 00 00 01 00 00 59 00 09 00");
  EXPECT_TRUE(groups.empty());
  EXPECT_EQ(ask("80 1d 00 01 59 00 09 00"), "80 1f 00 00 01 00 00 59 00 09 00");
  EXPECT_EQ(configuration_.find_model(generic_on_off_server)->subscriptions.size(), 2U);
  EXPECT_EQ(ask("80 1d 00 01 00 10"), "80 1f 00 00 01 00 00 00 10");
  EXPECT_TRUE(configuration_.find_model(generic_on_off_server)->subscriptions.empty());
}

TEST_F(ConfigServerTest, DeletesAKeyWithWhatUsesIt) {
  add_key();
  ask("80 3d 00 01 00 00 59 00 06 00");
  ask("03 00 01 01 00 00 00 04 00 00 59 00 06 00");
  EXPECT_EQ(ask("80 00 00 00 00"), "80 03 00 00 00 00");
  NodeConfiguration fresh;
  fresh.network = configuration_.network;
  EXPECT_EQ(configuration_, fresh);
  EXPECT_EQ(ask("80 00 00 00 00"), "80 03 00 00 00 00");
  EXPECT_EQ(ask("80 00 01 00 00"), "80 03 04 01 00 00");
}

TEST_F(ConfigServerTest, ResetsTheNodeAfterItsAnswer) {
  EXPECT_EQ(ask("80 49"), "80 4a");
  EXPECT_TRUE(was_reset_);
  EXPECT_EQ(ask("80 49 00"), "");
  EXPECT_FALSE(was_reset_);
}

TEST_F(ConfigServerTest, IsSilentToWhatItDoesNotKnow) {
  for (const char* message : {"", "7f", "80", "80 77 00", "c1 59 00 01", "04 00"}) {
    EXPECT_EQ(ask(message), "") << message;
  }
}

}  // namespace
}  // namespace slamgw::sim::ble
