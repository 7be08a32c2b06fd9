// SPDX-License-Identifier: Apache-2.0
// A robot's heartbeats, as heartbeat.c and config_server.c of Nordic's releases have them.
#include "simulation/ble/robot/heartbeats.hpp"

#include <gtest/gtest.h>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class HeartbeatsTest : public ::testing::Test {
 protected:
  explicit HeartbeatsTest(const Firmware& firmware = firmware_3_1_0) : heartbeats_(firmware) {
    ProvisioningData data;
    data.address = 0x0100;
    configuration_.join(data, Key{});
  }
  /// Returns the answer to a message, or "".
  std::string ask(std::string_view message) {
    const auto answer = heartbeats_.on_message(hex(message), configuration_, now_);
    return answer && *answer ? to_hex(**answer) : "";
  }
  unsigned published(Duration time) {
    const TimePoint end = now_ + time;
    unsigned count = 0;
    while (heartbeats_.deadline() && *heartbeats_.deadline() <= end) {
      now_ = std::max(now_, *heartbeats_.deadline());
      heartbeats_.on_deadline(now_);
      if (heartbeats_.next()) ++count;
    }
    now_ = end;
    return count;
  }
  void hear(unsigned count, std::uint8_t hops, Address source = 0x0101,
            Address destination = 0xc002) {
    for (unsigned i = 0; i < count; ++i) heartbeats_.on_heartbeat(source, destination, hops, now_);
  }

  TimePoint now_{seconds{1000}};
  NodeConfiguration configuration_;
  Heartbeats heartbeats_;
};

struct OldHeartbeatsTest : HeartbeatsTest {
  OldHeartbeatsTest() : HeartbeatsTest(firmware_2_2_0) {}
};

constexpr const char* publish_8 = "80 39 02 c0 04 01 05 00 00 00 00";

TEST_F(HeartbeatsTest, PublishesTheFirstAtOnceAndThenOneEachPeriod) {
  EXPECT_EQ(ask(publish_8), "06 00 02 c0 04 01 05 00 00 00 00");
  EXPECT_EQ(published(milliseconds{0}), 1U);
  EXPECT_EQ(published(seconds{3}), 3U);
  EXPECT_EQ(ask("80 38"), "06 00 02 c0 03 01 05 00 00 00 00") << "4 are left";
  EXPECT_EQ(published(milliseconds{1000}), 1U);
  EXPECT_EQ(ask("80 38"), "06 00 02 c0 03 01 05 00 00 00 00") << "3 are reported as 4";
  EXPECT_EQ(published(seconds{100}), 3U);
  EXPECT_FALSE(heartbeats_.deadline());
  EXPECT_EQ(ask("80 38"), "06 00 02 c0 00 01 05 00 00 00 00");
}

TEST_F(HeartbeatsTest, PublishesNoMoreWhenItIsSwitchedOff) {
  ask(publish_8);
  published(seconds{2});
  EXPECT_EQ(ask("80 39 00 00 00 00 00 00 00 00 00"), "06 00 00 00 00 00 00 00 00 00 00");
  EXPECT_EQ(published(seconds{20}), 0U);
  EXPECT_EQ(ask("80 38"), "06 00 00 00 00 00 00 00 00 00 00");
}

TEST_F(HeartbeatsTest, RefusesInvalidPublications) {
  EXPECT_EQ(ask("80 39 02 c0 04 01 05 00 00 01 00"), "06 04 02 c0 04 01 05 00 00 01 00");
  for (const char* request : {"02 c0 11 01 05 00 00 00 00", "02 c0 04 12 05 00 00 00 00",
                              "02 c0 04 01 80 00 00 00 00", "02 80 04 01 05 00 00 00 00"})
    EXPECT_EQ(ask("80 39 " + std::string(request)), "06 0f " + std::string(request));
  EXPECT_EQ(ask("80 39 02 c0 04 01 05 00 00 00"), "");
  EXPECT_EQ(ask("80 38 00"), "");
  EXPECT_EQ(published(seconds{9}), 0U);
}

TEST_F(HeartbeatsTest, CountsHeartbeatsOfOneSourceToOneDestination) {
  EXPECT_EQ(ask("80 3a"), "80 3c 00 00 00 00 00 00 00 00 00");
  EXPECT_EQ(ask("80 3b 01 01 02 c0 04"), "80 3c 00 01 01 02 c0 04 00 7f 00");
  hear(1, 3);
  hear(6, 2);
  hear(5, 1, 0x0102);
  hear(5, 1, 0x0101, 0xc003);
  EXPECT_EQ(ask("80 3a"), "80 3c 00 01 01 02 c0 04 03 02 03") << "7 are reported as 4";
  hear(1, 2);
  EXPECT_EQ(ask("80 3a"), "80 3c 00 01 01 02 c0 04 04 02 03");
  now_ += seconds{8};
  hear(8, 2);
  EXPECT_EQ(ask("80 3a"), "80 3c 00 01 01 02 c0 00 04 02 03") << "its time is over";
  EXPECT_EQ(ask("80 3b 00 00 00 00 00"), "80 3c 00 00 00 00 00 00 04 02 03");
  EXPECT_EQ(ask("80 3a"), "80 3c 00 00 00 00 00 00 00 00 00");
}

TEST_F(HeartbeatsTest, DoesNotAnswerASubscriptionThatIsNotAllowed) {
  for (const char* request : {"01 01 02 c0 12", "01 c1 02 c0 04", "01 01 00 80 04",
                              "01 01 01 01 04", "01 01 02 c0", "01 01 02 c0 04 00"})
    EXPECT_EQ(ask("80 3b " + std::string(request)), "") << request;
  EXPECT_EQ(ask("80 3b 01 01 00 01 04"), "80 3c 00 01 01 00 01 04 00 7f 00") << "its own address";
}

TEST_F(HeartbeatsTest, HearsTheGroupOfItsSubscription) {
  EXPECT_FALSE(heartbeats_.hears(0xc002, configuration_));
  ask("80 3b 01 01 02 c0 04");
  EXPECT_TRUE(heartbeats_.hears(0xc002, configuration_));
  EXPECT_FALSE(heartbeats_.hears(0xc003, configuration_));
  EXPECT_TRUE(heartbeats_.hears(all_nodes, configuration_));
}

TEST_F(OldHeartbeatsTest, HearsTheGroupsOfItsModelsAlone) {
  ask("80 3b 01 01 02 c0 04");
  EXPECT_FALSE(heartbeats_.hears(0xc002, configuration_));
  configuration_.find_model(pos_cmd_server)->subscriptions = {0xc002};
  EXPECT_TRUE(heartbeats_.hears(0xc002, configuration_));
}

TEST_F(OldHeartbeatsTest, FirstHeartbeatWaitsForTransmission) {
  ask(publish_8);
  EXPECT_FALSE(heartbeats_.next());
  heartbeats_.on_transmitted();
  EXPECT_TRUE(heartbeats_.next());
  heartbeats_.on_transmitted();
  EXPECT_FALSE(heartbeats_.next());
  EXPECT_EQ(published(seconds{20}), 7U);
}

TEST_F(OldHeartbeatsTest, FailsAssertionOnTwoRequestsBeforeTransmission) {
  ask(publish_8);
  heartbeats_.on_transmitted();
  EXPECT_NE(ask(publish_8), "");
  EXPECT_FALSE(heartbeats_.failed_assertion());
  EXPECT_EQ(ask(publish_8), "");
  EXPECT_TRUE(heartbeats_.failed_assertion());
}

}  // namespace
}  // namespace slamgw::sim::ble
