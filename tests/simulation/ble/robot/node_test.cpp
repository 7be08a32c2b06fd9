// SPDX-License-Identifier: Apache-2.0
// A robot in the mesh: access to its configuration, publications, commands, replay protection, and
// its removal.
#include "simulation/ble/robot/node.hpp"

#include <gtest/gtest.h>

#include "tests/simulation/ble/mesh_host.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

const char* const add_key = "00 00 00 00 101112131415161718191a1b1c1d1e1f";
const char* const bind_updates = "80 3d 00 01 00 00 59 00 06 00";
const char* const publish_updates = "03 00 01 01 00 00 00 05 00 00 59 00 06 00";

class NodeTest : public ::testing::Test {
 protected:
  static BleOptions options() {
    BleOptions out = MeshHost::unprovisioned();
    out.has_board_storage = true;  // forgetful_board_test.cpp has the other kind
    out.common.messages = 5;
    return out;
  }
  explicit NodeTest(const BleOptions& with = options()) : host_(with) { host_.adopt(0x0100); }

  /// Returns the opcode octets of the messages that arrive from the robot.
  std::vector<std::uint8_t> said(Duration time = seconds{20}) {
    host_.packets.clear();
    host_.run(time);
    std::vector<std::uint8_t> out;
    for (const Bytes& packet : host_.packets) {
      if (packet[1] == 0xd0) out.push_back(packet[21]);
    }
    return out;
  }
  void configure_updates() {
    host_.ask(add_key);
    host_.ask(bind_updates);
    host_.ask(publish_updates);
  }

  MeshHost host_;
};

TEST_F(NodeTest, AnswersConfigurationUnderTheDeviceKey) {
  EXPECT_EQ(host_.ask("80 08 00").substr(0, 5), "02 00");
  EXPECT_EQ(host_.last_key_handle, 8);
  EXPECT_EQ(host_.ask(add_key), "80 03 00 00 00 00");
  EXPECT_EQ(host_.ask(bind_updates), "80 3e 00 00 01 00 00 59 00 06 00");
  EXPECT_EQ(host_.ask(publish_updates), "80 19 00 00 01 01 00 00 00 05 5a 00 59 00 06 00");
}

TEST_F(NodeTest, HearsNothingUnderAnotherDeviceKey) {
  host_.tell("03 9d 08 00");
  host_.tell("15 9c 00 01 00 00 000102030405060708090a0b0c0d0e0f");
  EXPECT_EQ(host_.ask("80 08 00"), "");
  EXPECT_EQ(host_.ask("80 08 00", 0), "");  // nor under the application key
}

TEST_F(NodeTest, IsNotHeardWhenTheBoardLacksTheDeviceKey) {
  host_.send("80 08 00");
  host_.tell("03 9d 08 00");
  EXPECT_FALSE(host_.await(0xd0, seconds{3}).has_value());
}

TEST_F(NodeTest, PublishesOnlyWithKeyBindingAndPublication) {
  EXPECT_TRUE(said().empty());
  host_.ask(add_key);
  EXPECT_TRUE(said().empty());
  host_.ask(publish_updates);
  EXPECT_TRUE(said().empty());
  host_.ask(bind_updates);
  EXPECT_EQ(said(), std::vector<std::uint8_t>(5, 0xcb));
  EXPECT_EQ(host_.packets.back()[10], 5);  // the TTL of the publication
}

TEST_F(NodeTest, IntroducesItselfWhenThatIsConfigured) {
  host_.ask(add_key);
  for (const char* model : {"04", "06"}) {
    host_.ask("80 3d 00 01 00 00 59 00 " + std::string(model) + "00");
    host_.ask("03 00 01 01 00 00 00 04 00 00 59 00 " + std::string(model) + "00");
  }
  EXPECT_EQ(said(), (std::vector<std::uint8_t>{0xc7, 0xcb, 0xcb, 0xcb, 0xcb, 0xcb}));
}

TEST_F(NodeTest, PublishesItsHealthAtTheConfiguredPeriod) {
  host_.ask(add_key);
  host_.ask("80 3d 00 01 00 00 02 00");
  host_.ask("03 00 01 01 00 00 00 04 00 00 02 00");
  EXPECT_TRUE(said(seconds{60}).empty());            // no period, no periodic status
  host_.ask("03 00 01 01 00 00 00 04 44 00 02 00");  // 4 s
  said(seconds{10});
  EXPECT_EQ(said(seconds{20}), std::vector<std::uint8_t>(5, 0x04));
}

TEST_F(NodeTest, SendsUnderOldKeyUntilNewOneIsInForce) {
  configure_updates();
  const Key old_key = host_.network().nodes()[0].configuration().net_keys[0].key;
  host_.ask("80 45 00 00 a0a1a2a3a4a5a6a7a8a9aaabacadaeaf");
  EXPECT_EQ(said(), std::vector<std::uint8_t>(5, 0xcb));
  EXPECT_EQ(host_.ask("80 16 00 00 02"), "");  // the answer is under the new key
  host_.tell("13 93 00 00 a0a1a2a3a4a5a6a7a8a9aaabacadaeaf");
  EXPECT_EQ(host_.ask("80 16 00 00 02"), "80 17 00 00 00 02");  // the board hears both
  EXPECT_EQ(host_.ask("80 08 00").substr(0, 2), "02");
  EXPECT_EQ(host_.ask("80 16 00 00 03"), "80 17 00 00 00 00");
  EXPECT_EQ(host_.ask("80 08 00"), "");
  EXPECT_NE(host_.network().nodes()[0].configuration().net_keys[0].key, old_key);
}

TEST_F(NodeTest, StopsAfterFailedAssertion) {
  configure_updates();
  for (const char* group : {"00", "01", "02", "03", "04", "05", "06", "07", "08", "09"}) {
    host_.ask("80 1b 00 01 " + std::string(group) + "c1 59 00 09 00");
  }
  EXPECT_FALSE(host_.network().next_failed_assertion().has_value());
  EXPECT_EQ(host_.ask("80 1d 00 01 59 00 09 00"), "");
  const auto failed = host_.network().next_failed_assertion();
  ASSERT_TRUE(failed.has_value());
  EXPECT_EQ(failed->first, 1U);
  EXPECT_FALSE(host_.network().next_failed_assertion().has_value());
  EXPECT_EQ(host_.ask("80 08 00"), "");
  EXPECT_TRUE(said(seconds{60}).empty());
  EXPECT_EQ(host_.network().robots()[0].tally().failed_assertions, 1U);
  EXPECT_TRUE(host_.network().has_sent_everything());
}

TEST_F(NodeTest, TakesCommandsForBoundModelsOnly) {
  host_.ask(add_key);
  EXPECT_EQ(host_.ask("cd 59 00 0a 00 ec ff", 0), "");
  EXPECT_EQ(host_.ask("82 02 01 07", 0), "");
  host_.ask("80 3d 00 01 00 00 59 00 09 00");
  EXPECT_EQ(host_.ask("cd 59 00 0a 00 ec ff", 0), "d0 59 00 00");
  EXPECT_EQ(host_.last_key_handle, 0);
  EXPECT_EQ(host_.ask("82 02 01 07", 0), "");
  host_.ask("80 3d 00 01 00 00 00 10");
  EXPECT_EQ(host_.ask("82 02 01 07", 0), "82 04 01");
  EXPECT_EQ(host_.network().robots()[0].tally().commands_received, 2U);
}

TEST_F(NodeTest, TakesGroupCommandsWhenSubscribed) {
  host_.ask(add_key);
  host_.ask("80 3d 00 01 00 00 59 00 09 00");
  host_.tell("03 a4 04 c0");  // address handle 1
  const char* const to_group = "12 ab 00 00 01 00 01 00 04 00 00 00 cd 59 00 0a 00 ec ff";
  host_.tell(to_group);
  EXPECT_TRUE(said(seconds{3}).empty());
  host_.ask("80 1b 00 01 04 c0 59 00 09 00");
  host_.packets.clear();
  host_.tell(to_group);
  EXPECT_EQ(to_hex(ByteView(host_.await(0xd0).value()).subspan(20)), "d0 59 00 00");
}

TEST_F(NodeTest, LeavesTheMeshOnNodeResetAndBeaconsAgain) {
  configure_updates();
  EXPECT_EQ(host_.ask("80 49"), "80 4a");
  EXPECT_TRUE(said().empty());
  EXPECT_EQ(host_.ask("80 08 00"), "");
  host_.tell("01 61");
  const std::optional<Bytes> beacon = host_.await(0xc0, seconds{3});
  ASSERT_TRUE(beacon.has_value());
  EXPECT_EQ(to_hex(ByteView(*beacon).subspan(1, 4)), "73 6c 61 6d");
  host_.tell("01 62");
  EXPECT_EQ(host_.provision(0x0105).size(), 16U);
}

TEST_F(NodeTest, KeepsItsConfigurationThroughTheHostsRestart) {
  host_.ask(add_key);
  host_.tell("01 0e");
  host_.await(0x81);
  EXPECT_EQ(host_.ask("00 00 00 00 ff1112131415161718191a1b1c1d1e1f"), "80 03 06 00 00 00");
  EXPECT_EQ(host_.ask(bind_updates), "80 3e 00 00 01 00 00 59 00 06 00");
}

TEST_F(NodeTest, DiscardsTheBoardsMessagesAfterStateClearUntilTheyPassTheOldNumber) {
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(host_.ask("80 08 00").empty());
  const Key key = host_.network().nodes()[0].configuration().device_key;
  host_.tell("01 ac");
  host_.set_up();
  Bytes add = hex("9c 00 01 00 00");
  put(add, key);
  host_.command(add);
  host_.tell("03 a4 00 01");
  int discarded = 0;
  while (discarded < 30 && host_.ask("80 08 00").empty()) ++discarded;
  EXPECT_EQ(discarded, 10);
}

TEST_F(NodeTest, IsHeardAfterTheBoardsRestart) {
  EXPECT_FALSE(host_.ask("80 08 00").empty());
  host_.reboot();
  host_.await(0x81);
  EXPECT_FALSE(host_.ask("80 08 00").empty());  // its numbers go on with the next block
}

class LossyNodeTest : public NodeTest {
 protected:
  static BleOptions lossy() {
    BleOptions out = options();
    out.common.loss = 0.3;
    out.has_segment_timing = true;
    return out;
  }
  LossyNodeTest() : NodeTest(lossy()) {}
};

TEST_F(LossyNodeTest, GetsSegmentedMessagesByRepeats) {
  int completed = 0;
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(host_.send(add_key).substr(0, 8), "07 84 ab");
    EXPECT_EQ(host_.send(add_key), "03 84 ab 83");  // the first is still being sent
    host_.packets.clear();
    host_.run(seconds{4});
    completed += std::any_of(host_.packets.begin(), host_.packets.end(),
                             [](const Bytes& packet) { return packet[1] == 0xd2; });
  }
  EXPECT_GE(completed, 18);
  ASSERT_EQ(host_.network().nodes()[0].configuration().app_keys.size(), 1U);
}

TEST_F(NodeTest, TakesAirTimeOfSegmentsOnRequest) {
  BleOptions timed = options();
  timed.has_segment_timing = true;
  MeshHost host(timed);
  host.adopt(0x0100);
  const TimePoint begin = host.now();
  host.send(add_key);
  host.await(0xd2);
  EXPECT_EQ(host.now() - begin, milliseconds{350});
  host.tell("03 a4 04 c0");
  host.tell("17 ab 00 00 01 00 01 00 04 00 00 00 c5 59 00 01 02 03 04 05 06 07 08 09");
  const TimePoint second = host.now();
  host.await(0xd2);
  EXPECT_EQ(host.now() - second, milliseconds{2500});
}

TEST_F(NodeTest, NeverCompletesSegmentedMessageToUnknownAddress) {
  host_.tell("03 a4 77 07");  // address handle 1: no robot has this address
  EXPECT_EQ(host_.tell("17 ab 00 00 01 00 01 00 04 00 00 00 c5 59 00 01 02 03 04 05 06 07 08 09")
                .substr(0, 8),
            "07 84 ab");
  EXPECT_FALSE(host_.await(0xd2, seconds{60}).has_value());
}

TEST(ReplayList, TakesHigherNumbersOnlyAndFortySources) {
  ReplayList list;
  EXPECT_TRUE(list.accept(0x0100, 5));
  EXPECT_FALSE(list.accept(0x0100, 5));
  EXPECT_FALSE(list.accept(0x0100, 4));
  EXPECT_TRUE(list.accept(0x0100, 9));
  for (Address source = 0x0200; source < 0x0200 + 39; ++source) {
    EXPECT_TRUE(list.accept(source, 0));
  }
  EXPECT_FALSE(list.accept(0x0300, 0));
  EXPECT_TRUE(list.accept(0x0100, 10));
}

}  // namespace
}  // namespace slamgw::sim::ble
