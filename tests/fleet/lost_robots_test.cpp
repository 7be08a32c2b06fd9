// SPDX-License-Identifier: Apache-2.0
// Commands that a gateway has said it takes, when it loses their robot before its word is back.
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

/// A gateway whose own Taken is under way when gw-1 takes the robot over.
class LostRobots : public LoopedBack {
 protected:
  void SetUp() override {
    LoopedBack::SetUp();
    lost = SIZE_MAX;
    beat_of_gw_1(100'000);
    command(now);
    pass(100ms);
    ASSERT_EQ(said.size(), 1U);
    ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"r", 99, "gw-0"}}, at(now));
    ASSERT_FALSE(ownership.may_act_for("r", at(now).mono));
  }
  void comes_back(const Taken& taken) {
    ownership.on_fleet_message({"gw-0", ownership.life(), taken}, at(now));
  }
  Taken of_gw_1(std::uint64_t age_ms) const { return {7, said.at(0).key, "r", "cmd", age_ms}; }
};

TEST_F(LostRobots, LetsTheNewOwnerObjectWhenItRefusesWhatItTook) {
  comes_back(said[0]);
  pass(100ms);
  ASSERT_EQ(said.size(), 2U) << "others must know that it does not carry it out";
  EXPECT_TRUE(said[1].is_refusal);
  EXPECT_EQ(said[1].id, said[0].id) << "who has heard the first one has no copy left";
  comes_back(said[0]);
  comes_back(said[1]);
  pass(1s);
  ownership.on_fleet_message({"gw-1", 0x20001, of_gw_1(1300)}, at(now));
  pass(10s);
  EXPECT_EQ(carried, 0);
  EXPECT_TRUE(ends.empty());
}

TEST_F(LostRobots, RefusesWhatItTookWhenNobodyObjects) {
  lost = 1;
  comes_back(said[0]);
  pass(2s);
  EXPECT_TRUE(ends.empty()) << "somebody may object still";
  pass(2s);
  EXPECT_EQ(carried, 0);
  ASSERT_EQ(ends.size(), 1U);
  EXPECT_EQ(ends[0].why, "the robot moved to another gateway just then");
}

TEST_F(LostRobots, DoesNotSayAgainThatItTakesTheCommand) {
  pass(3s);
  ASSERT_GE(said.size(), 3U);
  for (std::size_t i = 1; i < said.size(); ++i) EXPECT_TRUE(said[i].is_refusal) << i;
}

/// The new owner carries it out, and nobody has to ask.
TEST_F(LostRobots, LeavesTheCommandToTheNewOwnerThatTakesIt) {
  ownership.on_fleet_message({"gw-1", 0x20001, of_gw_1(200)}, at(now));
  pass(10s);
  EXPECT_EQ(said.size(), 1U);
  EXPECT_TRUE(ends.empty());
}

/// gw-2 had taken it too, and has lost the robot as this one has.
TEST_F(LostRobots, RefusesWhatAnotherOneTookThatHasLostTheRobotToo) {
  lost = 1;
  ownership.on_fleet_message({"gw-2", 0x30001, of_gw_1(100)}, at(now));
  pass(100ms);
  Taken theirs = of_gw_1(200);
  theirs.is_refusal = true;
  ownership.on_fleet_message({"gw-2", 0x30001, theirs}, at(now));
  pass(10s);
  EXPECT_EQ(carried, 0);
  EXPECT_EQ(ends.size(), 1U);
}

TEST_F(LostRobots, YieldsToAnotherOneOfALesserNameThatHasLostTheRobotToo) {
  lost = 1;
  ownership.on_fleet_message({"g", 0x30001, of_gw_1(100)}, at(now));
  pass(100ms);
  Taken theirs = of_gw_1(200);
  theirs.is_refusal = true;
  ownership.on_fleet_message({"g", 0x30001, theirs}, at(now));
  pass(10s);
  EXPECT_TRUE(ends.empty());
}

/// gw-2 has heard from gw-1 that it takes the command, and that it refuses it after all. Both die.
TEST_F(LoopedBack, GatewayThatRefusesWhatItTookOwesNoOutcomeWhenAnotherOneObjects) {
  Taken theirs{1, 7, "y", "cmd", 0};
  ownership.on_fleet_message({"gw-1", 0x20001, theirs}, at(now));
  theirs.is_refusal = true;
  ownership.on_fleet_message({"gw-1", 0x20001, theirs}, at(now));
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0}}, at(now));
  pass(60s);
  EXPECT_EQ(ends.size(), 1U);
}

}  // namespace
}  // namespace slamgw::fleet::test
