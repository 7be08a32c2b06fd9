// SPDX-License-Identifier: Apache-2.0
// The robot's configuration server beyond the transcripts: bounds, dependencies, and requests that
// stop Nordic's robots.
#include "simulation/ble/robot/config_server.hpp"

#include <gtest/gtest.h>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

class ConfigServerTest : public ::testing::Test {
 protected:
  ConfigServerTest() {
    ProvisioningData data;
    data.address = 0x0100;
    configuration_.join(data, Key{});
  }
  std::string ask(std::string_view message, const Firmware& firmware = firmware_3_1_0) {
    const ConfigServer::Result result =
        ConfigServer(firmware, configuration_).on_message(hex(message));
    was_reset_ = result.resets_node;
    failed_assertion_ = result.failed_assertion.value_or("");
    return result.answer ? to_hex(*result.answer) : "";
  }
  void add_key() { ask("00 00 00 00 101112131415161718191a1b1c1d1e1f"); }
  /// Subscribes the position command server to `count` groups; returns the last status.
  std::string subscribe(int groups) {
    std::string answer;
    for (int i = 0; i < groups; ++i) {
      Bytes message = hex("80 1b 00 01 00 c1 59 00 09 00");
      message[4] = static_cast<std::uint8_t>(i);
      answer = ask(to_hex(message));
    }
    return answer;
  }
  const Model& model(ModelId id) const { return *configuration_.find_model(id); }

  NodeConfiguration configuration_;
  bool was_reset_ = false;
  std::string failed_assertion_;
};

TEST_F(ConfigServerTest, ReportsItsComposition) {
  const char* const page_0 =
      "02 00 59 00 01 00 01 00 28 00 01 00 00 00 03 06 00 00 02 00 00 10 "
      "59 00 00 00 59 00 04 00 59 00 05 00 59 00 06 00 59 00 08 00 59 00 09 00";
  EXPECT_EQ(ask("80 08 00"), page_0);
  EXPECT_EQ(ask("80 08 ff"), page_0);
}

TEST_F(ConfigServerTest, StoresEightApplicationKeys) {
  EXPECT_EQ(ask("00 00 60 45 101112131415161718191a1b1c1d1e1f"), "80 03 00 00 60 45");
  EXPECT_EQ(configuration_.app_keys[0].index, 0x456);
  for (int index = 0; index < 7; ++index) {
    ask("00 00 " + std::to_string(index) + "0 00 101112131415161718191a1b1c1d1e1f");
  }
  EXPECT_EQ(ask("00 00 90 00 101112131415161718191a1b1c1d1e1f"), "80 03 05 00 90 00");
}

TEST_F(ConfigServerTest, StoresPublicationOfModel) {
  add_key();
  EXPECT_EQ(ask("03 00 01 01 00 00 10 ff 4a 05 02 00"),
            "80 19 00 00 01 01 00 00 10 ff 4a 05 02 00");
  const ModelPublication& health = model(health_server).publication;
  EXPECT_EQ(health, (ModelPublication{0x0001, 0, true, 0xff, 0x4a, 0x05}));
  EXPECT_EQ(publish_period(health.period), std::chrono::seconds{10});
}

TEST_F(ConfigServerTest, AnswersUndefinedPeriodForModelWithoutOne) {
  add_key();
  EXPECT_NE(ask("03 00 01 01 00 00 00 04 00 00 59 00 06 00").substr(30, 2), "00");
  EXPECT_EQ(model(sensor_update_client).publication.period, 0);
}

TEST_F(ConfigServerTest, IsSubscribedToThirtyTwoGroupsInAll) {
  EXPECT_EQ(subscribe(32).substr(0, 8), "80 1f 00");
  EXPECT_EQ(ask("80 1b 00 01 00 c2 59 00 05 00").substr(0, 8), "80 1f 05");
  EXPECT_EQ(ask("80 1b 00 01 01 c1 59 00 05 00").substr(0, 8), "80 1f 00");
}

TEST_F(ConfigServerTest, OverwritesSubscriptions) {
  const std::vector<Address>& groups = model(pos_cmd_server).subscriptions;
  subscribe(9);
  EXPECT_EQ(ask("80 1e 00 01 10 c0 59 00 09 00"), "80 1f 00 00 01 10 c0 59 00 09 00");
  EXPECT_EQ(groups, std::vector<Address>{0xc010});
  EXPECT_EQ(ask("80 1e 00 01 ff ff 59 00 09 00"), "80 1f 01 00 01 ff ff 59 00 09 00");
  EXPECT_EQ(ask("80 1e 01 01 04 c0 59 00 09 00"), "80 1f 01 01 01 04 c0 59 00 09 00");
  EXPECT_EQ(ask("80 1e 00 01 04 c0 00 00"), "80 1f 08 00 01 04 c0 00 00");
  EXPECT_EQ(groups, std::vector<Address>{0xc010});
}

TEST_F(ConfigServerTest, DeletesKeyWithItsBindingsAndPublications) {
  add_key();
  ask("80 3d 00 01 00 00 59 00 06 00");
  ask("03 00 01 01 00 00 00 04 00 00 59 00 06 00");
  EXPECT_EQ(ask("80 00 00 00 00"), "80 03 00 00 00 00");
  NodeConfiguration fresh;
  fresh.join(*configuration_.network, Key{});
  EXPECT_EQ(configuration_, fresh);
}

TEST_F(ConfigServerTest, DeletesANetworkWithItsKeys) {
  ask("80 40 05 00 101112131415161718191a1b1c1d1e1f");
  ask("00 05 10 00 101112131415161718191a1b1c1d1e1f");
  ASSERT_EQ(configuration_.app_keys.size(), 1U);
  EXPECT_EQ(ask("80 41 05 00"), "80 44 00 05 00");
  EXPECT_TRUE(configuration_.app_keys.empty());
  EXPECT_EQ(configuration_.net_keys.size(), 1U);
}

TEST_F(ConfigServerTest, ResetsTheNodeAfterItsAnswer) {
  EXPECT_EQ(ask("80 49"), "80 4a");
  EXPECT_TRUE(was_reset_);
  EXPECT_EQ(ask("80 49 00"), "");
  EXPECT_FALSE(was_reset_);
}

TEST_F(ConfigServerTest, IgnoresUnknownAndTruncatedMessages) {
  for (const char* message : {"", "80", "81 99 00", "7f", "c0 59", "03", "80 1b 00 01 04",
                              "03 00 01 01 00 00 00 04 00 00 59", "80 1d 00 01 02 c0 59 00 09 00",
                              "80 3d 00 01 00 00 59 00 06", "00 00 00 00 10"}) {
    EXPECT_EQ(ask(message), "") << message;
  }
  EXPECT_EQ(failed_assertion_, "");
}

TEST_F(ConfigServerTest, FailsAssertionWhenManySubscriptionsAreClearedAtOnce) {
  ASSERT_EQ(configuration_.models.size(), 9U);
  for (const char* clear : {"80 1d 00 01 59 00 09 00", "80 1e 00 01 10 c0 59 00 09 00",
                            "80 22 00 01 505152535455565758595a5b5c5d5e5f 59 00 09 00"}) {
    configuration_.find_model(pos_cmd_server)->subscriptions.clear();
    subscribe(9);
    EXPECT_NE(ask(clear), "") << clear;
    EXPECT_EQ(failed_assertion_, "") << clear;
    ask("80 1d 00 01 59 00 09 00");
    subscribe(10);
    for (const Firmware* firmware : {&firmware_2_2_0, &firmware_3_1_0, &firmware_5_0_0}) {
      EXPECT_EQ(ask(clear, *firmware), "") << clear;
      EXPECT_NE(failed_assertion_, "") << clear;
    }
    ask("80 1c 00 01 00 c1 59 00 09 00");  // single deletions cause no failure
    EXPECT_EQ(failed_assertion_, "");
  }
}

TEST_F(ConfigServerTest, FailsAssertionOnProhibitedTtlUpToRelease420) {
  add_key();
  for (const char* set :
       {"03 00 01 01 00 00 00 80 00 00 59 00 06 00", "03 00 01 01 00 00 00 fe 00 00 59 00 06 00"}) {
    for (const Firmware* firmware : {&firmware_2_2_0, &firmware_3_1_0}) {
      EXPECT_EQ(ask(set, *firmware), "");
      EXPECT_NE(failed_assertion_, "");
    }
    EXPECT_EQ(ask(set, firmware_5_0_0), "");
    EXPECT_EQ(failed_assertion_, "");
  }
  EXPECT_NE(ask("03 00 01 01 00 00 00 7f 00 00 59 00 06 00"), "");
  EXPECT_EQ(failed_assertion_, "");
}

}  // namespace
}  // namespace slamgw::sim::ble
