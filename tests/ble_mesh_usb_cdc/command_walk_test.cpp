// SPDX-License-Identifier: Apache-2.0
// Seeded random walks of commands to several robots on virtual time: a lossy radio, robots that are
// switched off and on, a board that restarts, falls silent, is busy or unplugged. Each command has
// one outcome within 30 s. A delivered command was received, and no command is sent after its
// outcome.
#include <gtest/gtest.h>

#include <map>
#include <random>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t first_address = 0x0100;
constexpr std::size_t robot_count = 5;

struct Chances {
  double radio_loss = 0.2;
  double switch_off = 0.003;  ///< probability in one step, for each robot
  double command = 0.02;
  double restart = 0;  ///< probability in one step, for the board
  double silence = 0;
  double unplug = 0;
  double busy = 0;
  double lost_transfer = 0;
};

struct Issued {
  std::uint16_t robot = 0;
  TimePoint at{};
  bool is_numbered = false;  ///< its payload holds its number
};

class CommandWalk {
 public:
  CommandWalk(std::uint64_t seed, Chances chances)
      : chances_(chances), random_(seed), rig_(Settings{}, test_database(), names()) {
    rig_.spoil = [this](Bytes& transfer) {
      if (chance(chances_.lost_transfer)) transfer.clear();
    };
    rig_.start();
  }

  void run(int steps) {
    for (int i = 0; i < steps; ++i) step();
    chances_ = {.radio_loss = 0, .switch_off = 0, .command = 0};
    rig_.board.is_silent = false;
    for (int i = 0; i < 50 * 31; ++i) step();
    judge();
  }

  std::map<CommandResult, std::size_t> results;
  std::size_t transmissions = 0;

 private:
  static RobotNames names() {
    std::vector<RobotName> all;
    for (std::uint16_t n = 0; n < robot_count; ++n)
      all.push_back({"r" + std::to_string(n), static_cast<std::uint16_t>(first_address + n), {}});
    return RobotNames(all);
  }
  bool chance(double probability) {
    return std::uniform_real_distribution<double>(0, 1)(random_) < probability;
  }
  Duration between(Duration least, Duration most) {
    return Duration(
        std::uniform_int_distribution<Duration::rep>(least.count(), most.count())(random_));
  }

  void step() {
    disturb_board();
    for (std::uint16_t n = 0; n < robot_count; ++n) {
      if (chance(chances_.switch_off)) off_until_[n] = rig_.now + between(1s, 45s);
      if (chance(chances_.command)) issue(n);
    }
    receive();
    answer();
    rig_.run_for(20ms);
  }

  void disturb_board() {
    if (chance(chances_.restart)) rig_.say(rig_.board.restart());
    if (chance(chances_.silence)) silent_until_ = rig_.now + between(100ms, 9s);
    rig_.board.is_silent = rig_.now < silent_until_;
    if (chance(chances_.busy)) rig_.board.busy_sends = 3;
    if (!chance(chances_.unplug)) return;
    rig_.mesh.on_port_closed("unplugged", rig_.now);
    rig_.run_for(between(100ms, 5s));
    rig_.open();
  }

  void issue(std::uint16_t n) {
    const std::string robot = "r" + std::to_string(n);
    const std::uint32_t number = static_cast<std::uint32_t>(rig_.last_command) + 1;
    const Bytes numbered = ByteWriter{}.write_u32_le(number).take();
    issued_[CommandId{number}] = {static_cast<std::uint16_t>(first_address + n), rig_.now, true};
    switch (random_() % 4) {
      case 0: return rig_.command(robot + "/cmd", numbered);
      case 1:
        issued_[CommandId{number}].is_numbered = false;
        return rig_.command(robot + "/run", to_bytes("start"));
      case 2: return rig_.command(robot + "/long", numbered + Bytes(60, 7));
      default: return rig_.command(robot + "/x", numbered);
    }
  }

  /// The number in a message to a robot; 0: an on/off Set.
  static std::uint32_t number_in(const Bytes& access) {
    if (access[0] == 0x82) return 0;
    ByteReader reader(ByteView(access).subspan(3));
    return reader.read_u32_le();
  }

  void receive() {
    for (; next_sent_ < rig_.board.sent.size(); ++next_sent_) {
      const FakeBoard::SentPacket& packet = rig_.board.sent[next_sent_];
      const std::size_t n = packet.destination - first_address;
      if (rig_.now < off_until_[n] || chance(chances_.radio_loss)) continue;
      if (const std::uint32_t number = number_in(packet.payload))
        received_.insert(CommandId{number});
      Bytes status = packet.payload[0] == 0x82   ? hex("82 04 01")
                     : packet.payload[0] == 0xcd ? hex("d0 59 00 00")
                                                 : hex("c8 59 00 00");
      answers_.emplace(rig_.now + between(20ms, 120ms), std::pair(packet.destination, status));
    }
  }
  void answer() {
    while (!answers_.empty() && answers_.begin()->first <= rig_.now) {
      const auto [source, status] = answers_.begin()->second;
      answers_.erase(answers_.begin());
      if (!chance(chances_.radio_loss) && !rig_.board.is_silent)
        rig_.deliver_later(rig_.board.message(source, status));
    }
  }

  void judge() {
    std::map<CommandId, std::size_t> ended;  // packets sent before the outcome
    for (std::size_t i = 0; i < rig_.events.size(); ++i) {
      const auto* outcome = std::get_if<CommandOutcome>(&rig_.events[i]);
      if (outcome == nullptr) continue;
      const auto found = issued_.find(outcome->id);
      ASSERT_NE(found, issued_.end());
      EXPECT_TRUE(ended.emplace(outcome->id, rig_.sent_before[i]).second) << "a second outcome";
      EXPECT_LE(rig_.event_times[i] - found->second.at, 30s);
      ++results[outcome->result];
      const bool is_reported_delivered = outcome->result == CommandResult::delivered;
      if (is_reported_delivered && found->second.is_numbered) {
        EXPECT_TRUE(received_.contains(outcome->id))
            << "command " << static_cast<std::uint64_t>(outcome->id) << " did not reach the robot";
      }
    }
    EXPECT_EQ(ended.size(), issued_.size()) << "commands without an outcome";
    transmissions = rig_.board.sent.size();
    for (std::size_t i = 0; i < rig_.board.sent.size(); ++i) {
      const std::uint32_t number = number_in(rig_.board.sent[i].payload);
      if (number == 0) continue;
      EXPECT_LT(i, ended[CommandId{number}])
          << "command " << number << " was sent after its outcome";
    }
    EXPECT_EQ(rig_.board.count(0xac), 0u) << "no operator ordered the board to be cleared";
    EXPECT_TRUE(rig_.mesh.open_commands().empty()) << "no command is open";
  }

  Chances chances_;
  std::mt19937_64 random_;
  MeshRig rig_;
  std::map<CommandId, Issued> issued_;
  std::set<CommandId> received_;
  std::multimap<TimePoint, std::pair<std::uint16_t, Bytes>> answers_;
  std::array<TimePoint, robot_count> off_until_{};
  TimePoint silent_until_{};
  std::size_t next_sent_ = 0;
};

void walk(Chances chances, std::initializer_list<CommandResult> expected) {
  std::map<CommandResult, std::size_t> results;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    CommandWalk walk(seed, chances);
    walk.run(50 * 60);
    for (const auto& [result, count] : walk.results) results[result] += count;
    EXPECT_GT(walk.transmissions, 100u);
  }
  for (const CommandResult result : expected) EXPECT_GT(results[result], 0u) << to_string(result);
}

TEST(CommandWalk, EachCommandHasOneOutcomeOnLossyRadio) {
  walk({}, {CommandResult::delivered, CommandResult::timeout, CommandResult::superseded});
}

TEST(CommandWalk, EachCommandHasOneOutcomeWhenBoardRestarts) {
  walk({.restart = 0.002, .unplug = 0.0005}, {CommandResult::delivered, CommandResult::refused});
}

TEST(CommandWalk, EachCommandHasOneOutcomeWhenBoardIsSilentOrBusy) {
  walk({.silence = 0.002, .busy = 0.02}, {CommandResult::delivered, CommandResult::timeout});
}

TEST(CommandWalk, EachCommandHasOneOutcomeOnLossySerialLine) {
  walk({.lost_transfer = 0.02}, {CommandResult::delivered, CommandResult::timeout});
}

TEST(CommandWalk, EachCommandHasOneOutcomeWithAllFaultsAndFullQueues) {
  walk({.command = 0.1, .restart = 0.001, .silence = 0.001, .busy = 0.01, .lost_transfer = 0.005},
       {CommandResult::delivered, CommandResult::timeout, CommandResult::refused,
        CommandResult::superseded});
}

}  // namespace
}  // namespace slamgw::ble
