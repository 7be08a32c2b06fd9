// SPDX-License-Identifier: Apache-2.0
// Commands, outcomes and wills of a member, where its words or those of others are lost.
#include "tests/fleet/newcomer.hpp"

#include <optional>
#include <vector>

namespace slamgw::fleet::test {
namespace {

/// A gateway whose robot is "r", and a broker that gives back what it writes, or loses it.
class LoopedBack : public Newcomer {
 protected:
  void SetUp() override {
    ownership.on_broker_link(true, at(0s));
    states_answered(0s);
    state_comes("gw-1", 0s);
    pass(4s);
    ownership.on_heard("r", at(now));
    pass(1s);
    ASSERT_TRUE(ownership.may_act_for("r", at(now).mono));
  }
  void pass(Duration span) {
    for (const Duration end = now + span; now < end; now += 10ms) {
      while (auto action = ownership.next_action())
        std::visit([&](auto& what) { take(what); }, *action);
      ownership.on_deadline(at(now));
    }
  }
  template <class Action>
  void take(Action&) {}
  void take(CarryOut&) { ++carried; }
  void take(EndCommand& action) { ends.push_back(action); }
  void take(TellOutcome&) { ++told; }
  void take(PublishWill&) { ++wills; }
  void take(PublishNow& action) {
    const auto message = decode("gw-0", action.message.payload);
    ASSERT_TRUE(message);
    const auto* taken = std::get_if<Taken>(&message->body);
    if (taken) said.push_back(*taken);
    if (!is_writing_lost && (!taken || said.size() > lost))
      ownership.on_broker_message(action.message, at(now));
  }
  /// In a life that has heard everything for so long.
  void beat_of_gw_1(std::uint64_t up_ms) {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    ownership.on_fleet_message({"gw-1", 0x20001, Beat{sent_ms, 60'000, 0, 0, up_ms}}, at(now));
  }
  Duration now{};
  bool is_writing_lost = false;
  std::size_t lost = 0;  ///< that many of what it takes
  std::vector<Taken> said;
  std::vector<EndCommand> ends;
  int carried = 0;
  int told = 0;
  int wills = 0;
  std::uint64_t taken_ = 0;
};

TEST_F(LoopedBack, SaysAgainWhatItTakesWhenThatWasLost) {
  lost = 2;
  command(now);
  pass(1900ms);
  ASSERT_EQ(said.size(), 2U);
  EXPECT_EQ(carried, 0);
  pass(10s);
  ASSERT_EQ(said.size(), 3U) << "once a second, until it comes back";
  EXPECT_EQ(said[0].id, said[2].id);
  EXPECT_EQ(carried, 1);
  EXPECT_TRUE(ends.empty());
}

TEST_F(LoopedBack, RefusesWhatItCouldTakeOnlyTooLate) {
  lost = 6;
  command(now);
  pass(10s);
  EXPECT_EQ(carried, 0);
  ASSERT_EQ(ends.size(), 1U);
  EXPECT_EQ(ends[0].result, CommandResult::refused);
  EXPECT_GE(ends[0].after, 6s);
  EXPECT_LT(ends[0].after, 6200ms);
}

TEST_F(LoopedBack, LeavesACommandToWhoeverTookItWhileItsOwnWordWasLost) {
  lost = SIZE_MAX;
  command(now);
  pass(1500ms);
  const Taken theirs{7, CommandTurns::key_of({"p/server/r/cmd", {}, Qos::at_least_once, false}),
                     "r", "cmd"};
  ownership.on_fleet_message({"gw-1", 0x20001, theirs}, at(now));
  pass(10s);
  EXPECT_EQ(said.size(), 2U);
  EXPECT_EQ(carried, 0);
  EXPECT_TRUE(ends.empty());
}

TEST_F(LoopedBack, RefusesWhenItFallsAsleepWhatIsTooOldToBeCarriedOut) {
  lost = SIZE_MAX;
  ownership.on_broker_message(
      {"p/gateway/gw-1/state", to_bytes(R"({"state":"offline"})"), Qos::at_least_once, false},
      at(now));
  command(now);
  pass(70s);
  ASSERT_TRUE(ownership.is_alone());
  EXPECT_EQ(carried, 0);
  ASSERT_EQ(ends.size(), 1U);
  EXPECT_GE(ends[0].after, 50s);
}

/// gw-1 is retained as `online` and never says a word.
TEST_F(LoopedBack, IsAloneWhenAnOnlineGatewaySaysNothingForAnHour) {
  pass(59min);
  EXPECT_FALSE(ownership.is_alone());
  pass(2min);
  EXPECT_TRUE(ownership.is_alone());
  pass(57min);
  EXPECT_TRUE(ownership.is_alone());
  pass(3min);
  EXPECT_FALSE(ownership.is_alone()) << "it looks again: they may have been apart";
  pass(2min);
  EXPECT_TRUE(ownership.is_alone());
  ownership.on_fleet_message({"gw-1", 0x20001, Beat{1, 500, 0, 0}}, at(now));
  EXPECT_FALSE(ownership.is_alone());
}

TEST_F(LoopedBack, PublishesAWillOnlyWhenABusyBrokerHadTimeForAnAnswer) {
  is_writing_lost = true;  // and written by hand, later
  Report will;
  will.robot = "r";
  will.is_will = true;
  ownership.on_will(will, at(now));
  const TimePoint asked = at(now).mono;
  pass(900ms);
  ownership.on_fleet_message({"gw-0", ownership.life(), AskForSign{"r", 1}}, at(now));
  is_writing_lost = false;
  for (; wills == 0 && at(now).mono < asked + 10s;) pass(10ms);
  EXPECT_EQ(wills, 1);
  EXPECT_GE(at(now).mono - asked, 3600ms) << "four times as long as its own question took";
}

TEST_F(LoopedBack, AsksAgainWhenAQuestionWasLost) {
  is_writing_lost = true;
  Report will;
  will.robot = "r";
  will.is_will = true;
  ownership.on_will(will, at(now));
  pass(400ms);
  is_writing_lost = false;
  pass(8s);
  EXPECT_EQ(wills, 1);
}

/// The broker was away for 40 s for everybody, so that nobody else can have told the outcome.
TEST_F(LoopedBack, TellsALateOutcomeThatNobodyElseCouldHaveTold) {
  now += 40s;
  ownership.on_own_outcome({"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false}, 41s,
                           at(now));
  beat_of_gw_1(100);
  pass(5s);
  EXPECT_EQ(told, 1);
}

TEST_F(LoopedBack, LeavesALateOutcomeToWhoWasThereAllTheTime) {
  now += 40s;
  ownership.on_own_outcome({"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false}, 41s,
                           at(now));
  beat_of_gw_1(100'000);
  pass(5s);
  EXPECT_EQ(told, 0);
}

TEST_F(LoopedBack, LeavesTheOutcomesOfADeadGatewayToWhoWasThereAllTheTime) {
  for (const std::uint64_t up_ms : {100'000U, 100U}) {
    ends.clear();
    ownership.on_fleet_message({"gw-2", 0x30001, Taken{++taken_, 1, "r", "cmd", {}}}, at(now));
    now += 40s;
    pass(100ms);  // it notices that it was away
    beat_of_gw_1(up_ms);
    pass(20s);
    EXPECT_EQ(ends.size(), up_ms == 100 ? 1U : 0U) << "nobody else has heard of it";
  }
}

/// The subscription to commands stands before that to what others say.
TEST_F(LoopedBack, LeavesWhatCameBeforeItHeardTheOthersToThem) {
  for (const std::uint64_t up_ms : {100'000U, 0U}) {
    ends.clear();
    now += 40s;
    pass(10ms);  // it notices that it was away
    ownership.on_command({"p/server/other/cmd", {}, Qos::at_least_once, false}, "other", "cmd",
                         at(now - 10ms));
    beat_of_gw_1(up_ms);
    pass(20s);
    EXPECT_EQ(ends.size(), up_ms == 0 ? 1U : 0U) << "nobody else has heard of it";
  }
}

/// It comes from the broker's session for this gateway, after the outcome.
TEST_F(LoopedBack, LeavesWhatWasTakenWhileItWasAwayToWhoWasThere) {
  now += 10s;
  pass(10ms);  // it notices that it was away
  beat_of_gw_1(100'000);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 1, "r", "cmd", 0, false}}, at(now - 5ms));
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

TEST_F(LoopedBack, GatewayThatTakesACommandAgainInANewLifeOwesOneOutcome) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "r", "cmd", {}}}, at(now));
  pass(3s);
  ownership.on_fleet_message({"gw-2", 0x30002, Taken{2, 7, "r", "cmd", {}}}, at(now));
  ownership.on_outcome("gw-2", "r", "cmd", at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

/// gw-1 has heard of no owner's word and says that it refuses the command.
TEST_F(LoopedBack, OwnerSaysAgainThatItTookWhatAnotherOneRefuses) {
  command(now);
  pass(1s);
  ASSERT_EQ(carried, 1);
  const auto key = said.at(0).key;
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, key, "r", "cmd", 60'000, true}}, at(now));
  EXPECT_EQ(said.size(), 1U) << "another command, of a minute ago";
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{2, key, "r", "cmd", 1010, true}}, at(now));
  pass(10ms);
  ASSERT_EQ(said.size(), 2U);
  EXPECT_EQ(said[1].id, said[0].id);
  EXPECT_FALSE(said[1].is_refusal);
}

TEST_F(LoopedBack, RefusalYieldsToAnOwnerWhoseWordComesLater) {
  ownership.on_command({"p/server/other/cmd", {}, Qos::at_least_once, false}, "other", "cmd",
                       at(now));
  while (said.empty()) pass(10ms);
  ASSERT_TRUE(said[0].is_refusal);
  pass(1s);
  EXPECT_TRUE(ends.empty()) << "its own word is back, but an owner's may be under way";
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, said[0].key, "other", "cmd", {}}}, at(now));
  pass(10s);
  EXPECT_TRUE(ends.empty());
}

TEST_F(LoopedBack, WhatOthersTookCancelsAnEqualCommandForAMomentOnly) {
  const auto key = CommandTurns::key_of({"p/server/r/cmd", {}, Qos::at_least_once, false});
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, key, "r", "cmd", {}}}, at(now));
  pass(15s);
  command(now);
  pass(1s);
  EXPECT_EQ(carried, 1);
}

TEST_F(LoopedBack, GoesOnAloneWhenTheBrokerForbidsTheFleetLater) {
  is_writing_lost = true;
  ownership.on_broker_link(false, at(now));
  ownership.on_broker_link(true, at(now));
  pass(15s);
  EXPECT_TRUE(ownership.is_alone());
}

}  // namespace
}  // namespace slamgw::fleet::test
