// SPDX-License-Identifier: Apache-2.0
// firmware/examples/ble_robot.c against the daemon's BLE mesh adapter, on a virtual clock.
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

extern "C" {
#include "firmware/examples/ble_robot.h"
}

namespace {

// State of the functions that the example calls in its firmware.
std::vector<slamgw::Bytes> said;
std::int16_t place_x_cm = 10;
std::vector<std::pair<int, int>> targets;

}  // namespace

extern "C" {
void mesh_publish(const uint8_t* octets, size_t size) { said.emplace_back(octets, octets + size); }
void mesh_reply(const uint8_t* octets, size_t size) { said.emplace_back(octets, octets + size); }
void robot_place(int16_t* x_cm, int16_t* y_cm) {
  *x_cm = place_x_cm++;
  *y_cm = -20;
}
void robot_drive_to(int16_t x_cm, int16_t y_cm) { targets.emplace_back(x_cm, y_cm); }
}

namespace slamgw::firmware {
namespace {

using namespace std::chrono_literals;

class ExampleOnBle : public ::testing::Test {
 protected:
  ExampleOnBle() {
    said.clear();
    targets.clear();
    place_x_cm = 10;
    rig.start();
    robot_start(now_ms(), 7);
  }

  std::uint32_t now_ms() const {
    const auto passed =
        std::chrono::duration_cast<std::chrono::milliseconds>(rig.now.time_since_epoch());
    return static_cast<std::uint32_t>(passed.count());
  }

  /// Lets time pass. The broker acknowledges at once; each n-th message in either direction is
  /// lost.
  void pass(std::chrono::milliseconds time, unsigned each_lost = 0) {
    for (auto passed = 0ms; passed < time; passed += 20ms) {
      robot_run(now_ms());
      for (const Bytes& octets : std::exchange(said, {})) {
        ++sent;
        if (!is_lost(each_lost)) rig.say(rig.board.message(ble::first_robot, octets, 0));
      }
      const auto reports = rig.all<Report>();
      while (acknowledged < reports.size()) rig.receipt(reports[acknowledged++].receipt.id);
      rig.run_for(20ms);
      for (const auto& packet : std::exchange(rig.board.sent, {}))
        if (packet.destination == ble::first_robot && !is_lost(each_lost))
          robot_heard(packet.payload.data(), packet.payload.size());
    }
  }
  bool is_lost(unsigned each) { return each > 0 && ++carried % each == 0; }

  ble::MeshRig rig;
  std::size_t acknowledged = 0;
  unsigned carried = 0;
  unsigned sent = 0;
};

TEST_F(ExampleOnBle, PublishesItsPosition) {
  pass(1s);
  const auto reports = rig.all<Report>();
  ASSERT_GE(reports.size(), 4U);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_EQ(reports[0].payload, ble::hex("0a 00 ec ff"));
  EXPECT_EQ(reports[1].payload, ble::hex("0b 00 ec ff"));
  EXPECT_EQ(sent, reports.size()) << "each update is sent once";
}

TEST_F(ExampleOnBle, DeliversEachUpdateOnceOverALossyRadio) {
  pass(30s, 3);
  const auto reports = rig.all<Report>();
  ASSERT_GE(reports.size(), 20U);
  EXPECT_GT(sent, reports.size());
  for (std::size_t i = 0; i < reports.size(); ++i)
    EXPECT_EQ(reports[i].payload[0], static_cast<std::uint8_t>(10 + i));
}

TEST_F(ExampleOnBle, ObeysACommandAndAcknowledgesIt) {
  pass(100ms);
  rig.command("nr1/cmd", ble::hex("28 00 ec ff"));
  pass(2s);
  EXPECT_EQ(targets, (std::vector<std::pair<int, int>>{{40, -20}}));
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 1U);
  EXPECT_EQ(outcomes[0].result, CommandResult::delivered);
}

}  // namespace
}  // namespace slamgw::firmware
