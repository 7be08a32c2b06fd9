// SPDX-License-Identifier: Apache-2.0
// Robots and a board that forgets its sequence number: their replay lists, the addresses that it
// sends from, and the acknowledgements of segments.
#include <gtest/gtest.h>

#include "tests/simulation/ble/mesh_host.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class ForgetfulBoard : public ::testing::Test {
 protected:
  static constexpr Address robot = 0x0100;

  static BleOptions options() {
    BleOptions out = MeshHost::unprovisioned();
    out.has_segment_timing = true;
    out.common.body.payload = BodySettings::Payload::full;  // two segments each
    return out;
  }
  ForgetfulBoard() : host_(options()) {
    host_.set_up();
    device_key_ = host_.provision(robot);
    open_addresses();
  }
  /// Sets 64 addresses from 0x0001 on; the robot's device key is handle 8, its address handle 0.
  void open_addresses() {
    host_.tell("05 9f 01 00 40 00");
    Bytes add{0x9c, 0x00, 0x01, 0x00, 0x00};
    put(add, device_key_);
    host_.command(add);
    host_.tell("03 a4 00 01");
  }
  /// Power-cycles the board and sets it up again.
  void begin_new_life() {
    host_.network().reboot_board(host_.now());
    host_.run(Board::reboot_time);
    host_.tell("13 92 00 00" + std::string(MeshHost::net_key));
    open_addresses();
  }
  /// Returns true if the robot answers a Default TTL Get from this address.
  bool answers(Address source) {
    host_.packets.clear();
    Bytes send{0xab, 8, 0};
    put_u16_le(send, source);
    put(send, Bytes{0, 0, 4, 0, 0, 0, 0x80, 0x0c});
    host_.command(send);
    return host_.await(0xd0, seconds{1}).has_value();
  }
  /// Returns the number of requests from this address without an answer before the first answer.
  int silence(Address source) {
    int asked = 0;
    while (asked < 1000 && !answers(source)) ++asked;
    return asked;
  }

  MeshHost host_;
  Bytes device_key_;
};

TEST_F(ForgetfulBoard, IsNotHeardFromItsOldAddressUntilItHasPassedTheOldNumber) {
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(answers(0x0001));
  begin_new_life();
  EXPECT_EQ(silence(0x0001), 100);
  EXPECT_TRUE(answers(0x0001));
}

TEST_F(ForgetfulBoard, IsHeardAtOnceFromAnAddressThatTheRobotDoesNotKnow) {
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(answers(0x0001));
  begin_new_life();
  EXPECT_EQ(silence(0x0002), 0);
}

/// All addresses of the board share one sequence number.
TEST_F(ForgetfulBoard, PassesOldNumberWithMessagesFromAnyAddress) {
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(answers(0x0001));
  begin_new_life();
  for (int i = 0; i < 60; ++i) ASSERT_TRUE(answers(0x0002));
  EXPECT_EQ(silence(0x0001), 40);
}

TEST_F(ForgetfulBoard, IsNotHeardInItsFortyFirstLifeUntilTheRobotIsSwitchedOffAndOn) {
  for (Address life = 1; life <= ReplayList::capacity; ++life) {
    ASSERT_EQ(silence(life), 0) << life;
    begin_new_life();
  }
  EXPECT_EQ(silence(41), 1000) << "the list is full, and entries are never replaced";
  begin_new_life();
  EXPECT_EQ(silence(40), 1) << "a known address works once its number is passed";
  host_.network().power_cycle_robot(1);
  EXPECT_EQ(silence(41), 0);
}

TEST_F(ForgetfulBoard, GetsNoAcknowledgementOfItsSegmentsFromADeafRobot) {
  const std::string segmented =
      "00 00 00 00 20 21 22 23 24 25 26 27 28 29 2a 2b 2c 2d 2e 2f";  // AppKey Add
  EXPECT_NE(host_.ask(segmented), "");
  begin_new_life();
  host_.packets.clear();
  host_.send(segmented);
  EXPECT_FALSE(host_.await(0xd2, seconds{60}).has_value());
}

/// The board acknowledges segments from the address that they were sent to.
TEST_F(ForgetfulBoard, KeepsARobotBusyThatSendsSegmentsToItsOldAddress) {
  host_.ask("00 00 00 00 10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f");  // AppKey Add
  host_.ask("80 3d 00 01 00 00 59 00 06 00");                                // Model App Bind
  host_.run(seconds{1});                                   // the first one is still being sent
  host_.ask("03 00 01 01 00 00 00 04 00 20 59 00 06 00");  // Publication Set
  const auto updates = [&](Duration time) {
    host_.packets.clear();
    host_.run(time);
    return std::count_if(host_.packets.begin(), host_.packets.end(),
                         [](const Bytes& packet) { return packet[1] == 0xd0; });
  };
  host_.run(seconds{2});
  EXPECT_GT(updates(seconds{20}), 40) << "5 a second, 350 ms each on the air";
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(answers(0x0001));
  begin_new_life();
  host_.tell("15 97 00 00 00 00" + std::string(MeshHost::app_key));
  EXPECT_LT(updates(seconds{20}), 10) << "each occupies the robot for 3.5 s";
}

TEST_F(ForgetfulBoard, HearsARobotThatWasResetByHandOnlyAfterItsOwnRestart) {
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(answers(0x0001));
  host_.network().reset_robot_by_hand(1, host_.now());
  EXPECT_EQ(host_.network().nodes()[0].address(), 0);
  device_key_ = host_.provision(robot);
  host_.tell("03 9d 08 00");
  open_addresses();
  EXPECT_FALSE(answers(0x0001)) << "its numbers restart, and the board knows higher ones";
  begin_new_life();
  EXPECT_TRUE(answers(0x0002));
}

}  // namespace
}  // namespace slamgw::sim::ble
