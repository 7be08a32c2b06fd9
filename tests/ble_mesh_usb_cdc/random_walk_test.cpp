// SPDX-License-Identifier: Apache-2.0
// Seeded random walks on virtual time: robots that keep to reliable publish, a lossy radio, a board
// that restarts and falls silent, a serial line that loses transfers or single octets.
#include <gtest/gtest.h>

#include <map>
#include <random>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

/// Sends numbered updates; repeats each until its STATUS comes.
struct WalkRobot {
  std::uint16_t address = 0;
  std::uint16_t number = 0;
  TimePoint next_send{};
  Duration offset{};  ///< of the next repeat
  TimePoint first_sent{};
  std::size_t statuses_before = 0;
  bool is_waiting = false;

  Bytes message() const {
    return hex("c9 59 00") + ByteWriter{}.write_u16_le(number).write_u16_le(address).bytes();
  }
};

class Walk {
 public:
  explicit Walk(std::uint64_t seed) : random(seed), rig(Settings{}, test_database()) {
    for (std::uint16_t address = 0x0100; address < 0x0103; ++address)
      robots.push_back({.address = address});
    rig.start();
  }

  bool chance(double probability) {
    return std::uniform_real_distribution<double>(0, 1)(random) < probability;
  }

  void step() {
    collect();
    for (WalkRobot& robot : robots) act(robot);
    fire_receipts();
    if (chance(0.02)) {
      ++commands;
      rig.command("nr1/x", Bytes{static_cast<std::uint8_t>(commands)});
    }
    if (chance(0.3)) rig.hear(0x0100, "c8 59 00 00");
    if (relays) relay();
    if (chance(board_fault)) rig.say(rig.board.restart());
    if (chance(board_fault)) rig.board.is_silent = !rig.board.is_silent;
    rig.run_for(20ms);
  }

  /// Processes the events since the last call.
  void collect() {
    for (; next_event < rig.events.size(); ++next_event)
      if (const auto* report = std::get_if<Report>(&rig.events[next_event]))
        reports.push_back(*report);
    for (; next_sent < rig.board.sent.size(); ++next_sent)
      if (rig.board.sent[next_sent].payload == hex("cc 59 00 00"))
        ++statuses[rig.board.sent[next_sent].destination];
  }

  void act(WalkRobot& robot) {
    const std::size_t answered = statuses[robot.address];
    if (robot.is_waiting && answered > robot.statuses_before) {
      robot.statuses_before = answered;
      if (chance(radio_loss)) return;
      EXPECT_TRUE(safe.contains({robot.address, robot.number}))
          << "acknowledged before it was safe: " << robot.number;
      robot.is_waiting = false;
    }
    if (!robot.is_waiting && rig.now >= robot.next_send) {
      ++robot.number;
      robot.is_waiting = true;
      robot.first_sent = rig.now;
      robot.next_send = rig.now + 200ms;
      robot.offset = reliable_interval(4, 7);
      transmit(robot);
    } else if (robot.is_waiting && rig.now >= robot.first_sent + robot.offset) {
      robot.offset *= 2;
      transmit(robot);
    }
  }

  /// Robots of other meshes send more than the gateway relays.
  void relay() {
    for (const char* robot : {"ntnu-slam/robot/a/update", "ntnu-slam/robot/b/update"})
      rig.mesh.on_robot_message(
          {robot, hex(chance(0.5) ? "01 00 02 00" : "01 00 02 00 03 00 04 00"), Qos::at_most_once,
           false},
          rig.now);
  }

  void transmit(const WalkRobot& robot) {
    if (!chance(radio_loss) && !rig.board.is_silent)
      rig.deliver_later(rig.board.message(robot.address, robot.message(), 0xc003));
  }

  void fire_receipts() {
    for (; next_report < reports.size() && !chance(0.2); ++next_report) {
      const Report& report = reports[next_report];
      ByteReader payload(report.payload);
      const std::uint16_t number = payload.read_u16_le();
      if (chance(0.05)) {
        rig.receipt(report.receipt.id, ReceiptOutcome::refused);
        continue;
      }
      safe_twice += safe.insert({payload.read_u16_le(), number}).second ? 0 : 1;
      rig.receipt(report.receipt.id);
    }
  }

  void settle() {
    board_fault = radio_loss = 0;
    rig.spoil = nullptr;
    rig.board.is_silent = false;
    for (int i = 0; i < 600; ++i) step();
    rig.run_for(60s);
    collect();
    EXPECT_TRUE(rig.is_up());
    EXPECT_EQ(rig.board.count(0xac), 0u) << "no operator ordered the board to be cleared";
    EXPECT_EQ(rig.all<CommandOutcome>().size(), commands) << "one outcome for each command";
  }

  std::mt19937_64 random;
  MeshRig rig;
  std::vector<WalkRobot> robots;
  std::set<std::pair<std::uint16_t, std::uint16_t>> safe;
  std::size_t safe_twice = 0;  ///< duplicates upstream, without refused messages
  std::vector<Report> reports;
  std::map<std::uint16_t, std::size_t> statuses;
  std::size_t next_event = 0;
  std::size_t next_sent = 0;
  std::size_t next_report = 0;
  std::size_t commands = 0;
  double radio_loss = 0.1;
  double board_fault = 0;
  bool relays = false;
};

/// Checks that numbers are in order without a gap; returns how many were published twice.
std::size_t expect_complete(const Walk& walk) {
  std::map<std::uint16_t, std::uint16_t> last;
  std::size_t doubles = 0;
  for (const Report& report : walk.reports) {
    ByteReader payload(report.payload);
    const std::uint16_t number = payload.read_u16_le();
    std::uint16_t& seen = last[payload.read_u16_le()];
    if (number == seen) ++doubles;
    EXPECT_TRUE(number == seen || number == seen + 1) << seen << " then " << number;
    seen = number;
  }
  for (const WalkRobot& robot : walk.robots)
    EXPECT_GE(last[robot.address] + 1, robot.number) << "the last one may be in flight";
  return doubles;
}

TEST(RandomWalk, LosesNoAcknowledgedMessageOnLossyRadio) {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    Walk walk(seed);
    for (int i = 0; i < 1000; ++i) walk.step();
    walk.settle();
    EXPECT_LT(expect_complete(walk), walk.safe.size() / 10);
    EXPECT_GT(walk.safe.size(), 200u);
  }
}

/// Three robots at five messages a second, a tenth of all radio messages lost.
TEST(RandomWalk, LosesNothingAndDoublesLittleInTwentyMinutesOnLossyRadio) {
  Walk walk(1);
  for (int i = 0; i < 50 * 1200; ++i) walk.step();
  walk.settle();
  expect_complete(walk);
  EXPECT_LT(walk.safe_twice, walk.safe.size() / 20) << "of a tenth that lost their STATUS";
  EXPECT_GT(walk.safe.size(), 10000u);
}

TEST(RandomWalk, RelayingLosesNoMessageOfMesh) {
  for (const double fault : {0.0, 0.005}) {
    SCOPED_TRACE(fault);
    Walk walk(4);
    walk.relays = true;
    walk.board_fault = fault;
    for (int i = 0; i < 1000; ++i) walk.step();
    walk.settle();
    expect_complete(walk);
    EXPECT_GT(walk.rig.counter("relayed"), 50u);
    if (fault == 0.0) {
      EXPECT_EQ(walk.rig.counter("sends_dropped"), 0u) << "no queue was full";
    }
  }
}

TEST(RandomWalk, RecoversFromBoardThatRestartsAndFallsSilent) {
  std::uint64_t restarts = 0;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    Walk walk(seed);
    walk.board_fault = 0.005;
    for (int i = 0; i < 1000; ++i) walk.step();
    walk.settle();
    expect_complete(walk);
    restarts += walk.rig.counter("board_restarts");
  }
  EXPECT_GT(restarts, 0u);
}

TEST(RandomWalk, RecoversFromSerialLineThatLosesTransfers) {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    Walk walk(seed);
    walk.rig.spoil = [&](Bytes& transfer) {
      if (walk.chance(0.03)) transfer.clear();
    };
    for (int i = 0; i < 1000; ++i) walk.step();
    walk.settle();
    expect_complete(walk);
    EXPECT_GT(walk.rig.counter("command_timeouts"), 0u);
  }
}

TEST(RandomWalk, RecoversFromSerialLineThatLosesOctets) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    Walk walk(seed);
    walk.rig.spoil = [&](Bytes& transfer) {
      if (transfer.empty() || !walk.chance(0.02)) return;
      const auto at = static_cast<std::ptrdiff_t>(walk.random() % transfer.size());
      if (walk.chance(0.5)) {
        transfer.erase(transfer.begin() + at);
      } else {
        transfer.insert(transfer.begin() + at, static_cast<std::uint8_t>(walk.random()));
      }
    };
    // No checksum protects this line, so the test compares no content and checks only the recovery.
    for (int i = 0; i < 1000; ++i) {
      walk.rig.run_for(20ms);
      walk.rig.deliver_later(walk.rig.board.message(0x0100, hex("cb 59 00 01 00 02 00"), 0xc003));
      if (i % 50 == 0) {
        ++walk.commands;
        walk.rig.command("nr1/x", Bytes{1});
      }
    }
    walk.settle();
    EXPECT_GT(walk.rig.counter("resyncs"), 1u);
  }
}

}  // namespace
}  // namespace slamgw::ble
