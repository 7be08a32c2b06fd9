// SPDX-License-Identifier: Apache-2.0
// What is promised to users of a fleet, one sentence each.
#include <gtest/gtest.h>

#include <array>

#include "tests/fleet/fleet_world.hpp"

namespace slamgw::fleet::test {
namespace {

using namespace std::chrono_literals;

TEST(Ownership, OneGatewayAloneSaysNothing) {
  FleetWorld world({.gateways = 1, .robots = 3, .enabled = Enabled::automatic});
  world.run(30s);
  EXPECT_TRUE(world.ownership(0).is_alone());
  EXPECT_EQ(world.published_by_kind("beat"), 0U);
  EXPECT_EQ(world.published_by_kind("claim"), 0U);
}

/// One gateway without a world around it.
class Newcomer : public testing::Test {
 protected:
  static constexpr Life process = 0x10000;
  Now at(Duration after) const { return {TimePoint{} + 1h + after, {}}; }
  void command(Duration after) {
    ownership.on_command({"p/server/r/cmd", {}, Qos::at_least_once, false}, "r", "cmd", at(after));
  }
  void state_comes(const std::string& gateway, Duration after, bool retain = true) {
    ownership.on_broker_message({"p/gateway/" + gateway + "/state",
                                 to_bytes(R"({"state":"online"})"), Qos::at_least_once, retain},
                                at(after));
  }
  void states_answered(Duration after, SubscribeAnswer answer = SubscribeAnswer::granted) {
    ownership.on_subscribe_result("p/gateway/+/state", answer, at(after));
  }
  std::size_t carried_out() {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      count += std::holds_alternative<CarryOut>(*action) ? 1 : 0;
    return count;
  }
  Ownership ownership{
      {"p", "gw-0"}, {Enabled::automatic, process}, [] { return std::vector<LocalRobot>{}; }};
};

TEST_F(Newcomer, CarriesOutCommandsWhileItHasNeverSeenTheBroker) {
  EXPECT_FALSE(ownership.is_shared());
  command(0s);
  EXPECT_EQ(carried_out(), 1U);
}

TEST_F(Newcomer, HoldsCommandsUntilTheBrokerHasToldWhoElseIsThere) {
  ownership.on_broker_link(true, at(0s));
  command(10ms);
  state_comes("gw-0", 20ms);
  ownership.on_deadline(at(30ms));
  EXPECT_EQ(carried_out(), 0U);
  ASSERT_TRUE(ownership.deadline());
  EXPECT_LT(*ownership.deadline(), at(300ms).mono);
  ownership.on_deadline(at(300ms));
  EXPECT_EQ(carried_out(), 1U);
  EXPECT_FALSE(ownership.is_shared());
  EXPECT_FALSE(ownership.deadline());
}

TEST_F(Newcomer, ListensFromTheAnswerToItsSubscriptionOn) {
  ownership.on_broker_link(true, at(0s));
  command(10ms);
  state_comes("gw-0", 20ms, false);  // what it has said itself tells nothing about others
  ownership.on_deadline(at(1500ms));
  EXPECT_EQ(carried_out(), 0U);
  states_answered(2s);
  ownership.on_deadline(at(2900ms));
  EXPECT_EQ(carried_out(), 0U);
  states_answered(2900ms);  // the same filter, of a robot
  ownership.on_deadline(at(3s));
  EXPECT_EQ(carried_out(), 1U);
  EXPECT_FALSE(ownership.is_shared());
}

TEST_F(Newcomer, WakesUpWhenTheBrokerIsSlowToNameTheOthers) {
  ownership.on_broker_link(true, at(0s));
  command(10ms);
  ownership.on_deadline(at(1100ms));
  states_answered(2s);
  state_comes("gw-0", 2s);
  state_comes("gw-1", 2100ms);
  ownership.on_deadline(at(2300ms));
  EXPECT_EQ(carried_out(), 0U);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::joining);
}

TEST_F(Newcomer, DoesNotWaitForEverForABrokerThatAnswersNoSubscription) {
  ownership.on_broker_link(true, at(0s));
  command(10ms);
  ASSERT_EQ(ownership.deadline(), at(10s).mono);
  ownership.on_deadline(at(10s));
  EXPECT_EQ(carried_out(), 1U);
}

TEST_F(Newcomer, DoesNotWaitForStatesThatTheBrokerRefuses) {
  for (const auto answer : {SubscribeAnswer::refused, SubscribeAnswer::closes_connection}) {
    ownership.on_broker_link(true, at(0s));
    command(10ms);
    states_answered(20ms, answer);
    EXPECT_EQ(carried_out(), 1U);
    EXPECT_FALSE(ownership.is_shared());
  }
}

TEST_F(Newcomer, AsksAgainForWhatTheBrokerHasRefused) {
  const auto asked = [&] {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      count += std::holds_alternative<SubscribeFleet>(*action) ? 1 : 0;
    return count;
  };
  ownership.on_broker_link(true, at(0s));
  EXPECT_EQ(asked(), 2U) << "states and commands";
  states_answered(20ms, SubscribeAnswer::refused);
  ownership.on_broker_link(false, at(1s));
  ownership.on_broker_link(true, at(2s));
  EXPECT_EQ(asked(), 1U);
  states_answered(2020ms, SubscribeAnswer::closes_connection);
  ownership.on_broker_link(false, at(3s));
  ownership.on_broker_link(true, at(4s));
  EXPECT_EQ(asked(), 0U) << "asking again would close the connection again";
}

/// Nothing that it writes under fleet/ comes back, so that it goes on alone.
TEST_F(Newcomer, DecidesWhatWaitedWhenItFallsAsleep) {
  ownership.on_broker_link(true, at(0s));
  states_answered(10ms);
  state_comes("gw-1", 20ms);
  ASSERT_EQ(ownership.phase(), Ownership::Phase::joining);
  command(9s);
  Report will;
  will.robot = "r";
  will.is_will = true;
  ownership.on_will(will, at(9s));
  ownership.on_own_outcome({"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false}, 1s,
                           at(9s));
  const auto decided = [&] {
    std::array<std::size_t, 3> count{};
    while (const auto action = ownership.next_action()) {
      count[0] += std::holds_alternative<CarryOut>(*action) ? 1 : 0;
      count[1] += std::holds_alternative<PublishWill>(*action) ? 1 : 0;
      count[2] += std::holds_alternative<TellOutcome>(*action) ? 1 : 0;
    }
    return count;
  };
  ownership.on_deadline(at(10s));
  EXPECT_EQ(decided(), (std::array<std::size_t, 3>{0, 0, 0}));
  ownership.on_deadline(at(11s));
  ASSERT_TRUE(ownership.is_alone());
  EXPECT_EQ(decided(), (std::array<std::size_t, 3>{1, 1, 1}));
  ownership.on_broker_link(false, at(12s));
  ownership.on_broker_link(true, at(5h));
  ownership.on_deadline(at(6h));
  EXPECT_EQ(decided(), (std::array<std::size_t, 3>{0, 0, 0}));
}

/// The lines are those of docs/fleet.md.
TEST_F(Newcomer, NamesTheRightsThatItLacks) {
  ownership.on_broker_link(true, at(0s));
  state_comes("gw-1", 20ms);
  EXPECT_TRUE(ownership.missing_rights(at(9s).mono).empty()) << "not before its time";
  ownership.on_deadline(at(11s));
  ASSERT_TRUE(ownership.is_alone());
  const auto missing = ownership.missing_rights(at(11s).mono);
  ASSERT_EQ(missing.size(), 1U);
  EXPECT_EQ(missing[0].grant,
            "topic write p/fleet/all/gw-0, topic write p/fleet/to/+/gw-0, topic read p/fleet/#");
  bool is_told = false;
  while (const auto action = ownership.next_action()) {
    const auto* notice = std::get_if<Notice>(&*action);
    is_told = is_told || (notice && notice->text.find(missing[0].grant) != std::string::npos);
  }
  EXPECT_TRUE(is_told);
  ownership.on_broker_link(false, at(12s));
  ownership.on_broker_link(true, at(13s));
  EXPECT_TRUE(ownership.missing_rights(at(13s).mono).empty()) << "a new connection, a new try";
}

/// With `true` it goes on trying, and nobody would know why it carries out nothing.
TEST_F(Newcomer, NamesTheRightsThatItLacksWhileItGoesOnTrying) {
  Ownership ordered{
      {"p", "gw-0"}, {Enabled::yes, process}, [] { return std::vector<LocalRobot>{}; }};
  ordered.on_broker_link(true, at(0s));
  EXPECT_TRUE(ordered.missing_rights(at(9s).mono).empty());
  ordered.on_deadline(at(10s));
  EXPECT_FALSE(ordered.is_alone());
  EXPECT_EQ(ordered.missing_rights(at(10s).mono).size(), 1U);
  ordered.on_broker_link(false, at(11s));
  EXPECT_TRUE(ordered.missing_rights(at(30s).mono).empty()) << "the broker is away";
}

TEST_F(Newcomer, HoldsNothingWhenTheBrokerGoesMeanwhile) {
  ownership.on_broker_link(true, at(0s));
  command(10ms);
  ownership.on_broker_link(false, at(20ms));
  EXPECT_EQ(carried_out(), 1U);
  EXPECT_FALSE(ownership.is_shared());
}

TEST_F(Newcomer, IgnoresAStateThatIsTooLargeForAGateway) {
  ownership.on_broker_link(true, at(0s));
  const std::string version(5000, '1');
  ownership.on_broker_message(
      {"p/gateway/gw-1/state", to_bytes(R"({"state":"online","version":")" + version + R"("})"),
       Qos::at_least_once, true},
      at(10ms));
  EXPECT_TRUE(ownership.states().empty());
  EXPECT_TRUE(ownership.is_alone());
}

TEST_F(Newcomer, HearsCommandsBeforeItHearsTheOthers) {
  ownership.on_broker_link(true, at(0s));
  state_comes("gw-1", 10ms);
  std::vector<std::string> filters;
  while (const auto action = ownership.next_action())
    if (const auto* asked = std::get_if<SubscribeFleet>(&*action)) filters.push_back(asked->filter);
  ASSERT_EQ(filters.size(), 6U);
  EXPECT_EQ(filters[1], "p/server/+/+") << "alone";
  EXPECT_EQ(filters[2], "p/server/+/+") << "with others";
}

TEST_F(Newcomer, GoesOnHearingCommandsWhenTheOthersHaveGone) {
  const auto hears_commands = [&] {
    std::optional<bool> hears;
    while (const auto action = ownership.next_action()) {
      if (const auto* asked = std::get_if<SubscribeFleet>(&*action))
        if (asked->filter == "p/server/+/+") hears = true;
      if (const auto* left = std::get_if<UnsubscribeFleet>(&*action))
        if (left->filter == "p/server/+/+") hears = false;
    }
    return hears;
  };
  ownership.on_broker_link(true, at(0s));
  EXPECT_EQ(hears_commands(), true);
  states_answered(10ms);
  state_comes("gw-1", 20ms);
  ownership.on_deadline(at(11s));  // nothing that it writes under fleet/ comes back
  ASSERT_TRUE(ownership.is_alone());
  EXPECT_EQ(hears_commands(), false) << "others are about: it speaks for its own robots only";
  ownership.on_broker_link(false, at(12s));
  ownership.on_broker_link(true, at(13s));
  EXPECT_EQ(hears_commands(), true);
}

TEST_F(Newcomer, HasNoLeaseFromABeatThatItCannotHaveSent) {
  ownership.on_broker_link(true, at(0s));
  state_comes("gw-1", 10ms);
  for (const std::int64_t sent_ms : {std::int64_t{-1}, INT64_MIN, INT64_MAX, 3'600'021L}) {
    ownership.on_fleet_message({"gw-0", ownership.life(), Beat{sent_ms, 60'000, 0, 0}}, at(20ms));
    EXPECT_FALSE(ownership.is_leased(at(20ms).mono)) << sent_ms;
  }
  ownership.on_fleet_message({"gw-0", ownership.life(), Beat{3'600'019, 500, 0, 0}}, at(20ms));
  EXPECT_TRUE(ownership.is_leased(at(20ms).mono));
}

TEST(Peers, BeatWithAnyNumberDelaysAtMostByAnHour) {
  Peers peers;
  const TimePoint start{1h};
  constexpr std::int64_t start_ms = 3'600'000;
  // As if it had taken INT64_MIN milliseconds, and the next none.
  peers.on_beat("gw", 1, Beat{INT64_MIN + start_ms, 500, 0, 0}, start);
  peers.on_beat("gw", 1, Beat{start_ms + 1000, 500, 0, 0}, start + 1s);
  EXPECT_TRUE(peers.is_alive("gw", start + 1400ms));
  EXPECT_FALSE(peers.is_alive("gw", start + 2s)) << "its way was far longer than the shortest";
  peers.on_beat("gw", 2, Beat{INT64_MAX, 500, 0, 0}, start + 3s);
  peers.on_beat("gw", 2, Beat{INT64_MIN, 500, 0, 0}, start + 4s);
  EXPECT_FALSE(peers.is_alive("gw", start + 7s));
}

TEST_F(Newcomer, LosesNoCommandOfABurstWhileItLooks) {
  ownership.on_broker_link(true, at(0s));
  constexpr int burst = 20'000;
  for (int i = 0; i < burst; ++i) {
    const std::string robot = std::to_string(i);
    ownership.on_command({"p/server/" + robot + "/cmd", {}, Qos::at_least_once, false}, robot,
                         "cmd", at(10ms));
  }
  states_answered(20ms);
  ownership.on_deadline(at(2s));
  EXPECT_EQ(carried_out(), static_cast<std::size_t>(burst));
}

TEST_F(Newcomer, RefusesWhatItHasNoRoomForWhileItLooks) {
  ownership.on_broker_link(true, at(0s));
  constexpr std::size_t more = 10;
  for (std::size_t i = 0; i < CommandTurns::max_waiting + more; ++i) command(10ms);
  std::size_t refused = 0;
  while (const auto action = ownership.next_action())
    if (const auto* end = std::get_if<EndCommand>(&*action); end) {
      EXPECT_EQ(end->result, CommandResult::refused);
      ++refused;
    }
  EXPECT_EQ(refused, more);
  states_answered(20ms);
  ownership.on_deadline(at(2s));
  EXPECT_EQ(carried_out(), CommandTurns::max_waiting);
}

/// Of commands of an earlier process: others may have told them meanwhile.
TEST_F(Newcomer, HoldsOutcomesBackUntilItKnowsWhetherOthersAreAbout) {
  EXPECT_TRUE(ownership.may_be_shared());
  ownership.on_own_outcome({"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false}, 40s,
                           at(0s));
  const auto told = [&] {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      count += std::holds_alternative<TellOutcome>(*action) ? 1 : 0;
    return count;
  };
  ownership.on_broker_link(true, at(1s));
  EXPECT_EQ(told(), 0U);
  states_answered(1s);
  ownership.on_deadline(at(3s));
  EXPECT_EQ(told(), 1U) << "nobody is about";
  EXPECT_FALSE(ownership.may_be_shared());
}

TEST_F(Newcomer, LeavesOutcomesToTheStoreWhenItEndsBeforeItHasSeenTheBroker) {
  ownership.on_own_outcome({"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false}, 40s,
                           at(0s));
  ownership.on_stop();
  const auto action = ownership.next_action();
  ASSERT_TRUE(action);
  EXPECT_TRUE(std::holds_alternative<TellOutcome>(*action));
}

/// The filters that the broker is asked to forget.
std::set<std::string> unsubscribed(Ownership& ownership) {
  std::set<std::string> filters;
  while (const auto action = ownership.next_action())
    if (const auto* gone = std::get_if<UnsubscribeFleet>(&*action)) filters.insert(gone->filter);
  return filters;
}

TEST_F(Newcomer, UnsubscribesWhatAFormerProcessHasLeftAtTheBroker) {
  ownership.on_broker_link(true, at(0s), true);
  EXPECT_TRUE(unsubscribed(ownership).empty()) << "others may be about";
  states_answered(10ms);
  ownership.on_deadline(at(2s));
  const std::set<std::string> company{"p/fleet/all/+", "p/fleet/to/gw-0/+",
                                      "p/gateway/+/commands/+"};
  EXPECT_EQ(unsubscribed(ownership), company);
  ownership.on_broker_link(false, at(3s));
  ownership.on_broker_link(true, at(4s), false);
  states_answered(4s);
  ownership.on_deadline(at(6s));
  EXPECT_TRUE(unsubscribed(ownership).empty()) << "the broker has forgotten everything";
}

TEST(Ownership, UnsubscribesEverythingThatAFormerProcessHasLeftWhenItMayTakeNoPart) {
  Ownership ownership({"p", "gw-0"}, {Enabled::no, 0x10000},
                      [] { return std::vector<LocalRobot>{}; });
  ownership.on_broker_link(true, {TimePoint{1h}, {}}, true);
  EXPECT_EQ(unsubscribed(ownership).size(), 5U);
}

TEST_F(Newcomer, TellsOfARivalByItsBeatsAndNotByWhatTheBrokerHasKept) {
  ownership.on_broker_link(true, at(0s));
  state_comes("gw-1", 10ms);
  const Life other = 0x770001;
  const auto errors = [&] {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      if (const auto* notice = std::get_if<Notice>(&*action))
        count += notice->severity == Severity::error ? 1 : 0;
    return count;
  };
  for (int i = 0; i < 3; ++i)
    ownership.on_fleet_message({"gw-0", other, ClaimRobot{"r", 1, {}}}, at(20ms));
  ownership.on_fleet_message({"gw-0", other, Beat{1, 500, 0, 0}}, at(20ms));
  EXPECT_EQ(errors(), 0U) << "of the process before";
  ownership.on_fleet_message({"gw-0", other, Beat{501, 500, 0, 0}}, at(520ms));
  EXPECT_EQ(errors(), 1U);
}

TEST_F(Newcomer, GivesWhatOthersSayOnStatesAndOutcomesToRobotsToo) {
  ownership.on_broker_link(true, at(0s));
  const auto takes = [&](const std::string& topic) {
    return ownership.on_broker_message({topic, to_bytes("{}"), Qos::at_least_once, false},
                                       at(10ms));
  };
  EXPECT_FALSE(takes("p/gateway/gw-1/state"));
  EXPECT_FALSE(takes("p/gateway/gw-1/commands/r"));
  EXPECT_TRUE(takes("p/fleet/all/gw-1"));
}

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
    const auto sent_ms = std::chrono::duration_cast<milliseconds>(now).count();
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

TEST(Ownership, WakesUpWhenAnotherGatewayIsThereAndSleepsWhenItHasGone) {
  FleetWorld world({.gateways = 2, .robots = 3, .enabled = Enabled::automatic});
  world.kill(1);
  world.run(90s);
  EXPECT_TRUE(world.ownership(0).is_alone());
  world.start(1);
  world.run(5s);
  EXPECT_EQ(world.ownership(0).phase(), Ownership::Phase::member);
  EXPECT_EQ(world.ownership(1).phase(), Ownership::Phase::member);
  world.kill(1);
  world.run(90s);
  EXPECT_TRUE(world.ownership(0).is_alone());
}

TEST(Ownership, RobotThatRoamsHasOneOwnerWithinAFractionOfASecond) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  ASSERT_EQ(world.actors(0), std::vector<int>{0});
  world.roam(0, 2);
  world.run(300ms);
  EXPECT_EQ(world.actors(0), std::vector<int>{2});
}

/// A -> B -> C, and C claims it while A has not made way for B yet.
TEST(Ownership, SessionFollowsARobotThatMovesTwiceWithinOneHandover) {
  int lost = 0;
  for (std::uint32_t seed = 1; seed <= 40; ++seed) {
    FleetWorld world({.seed = seed, .gateways = 4, .robots = 1});
    world.run(5s);
    for (const int place : {1, 3}) {
      world.roam(0, place);
      world.run(milliseconds(seed * 3));
    }
    world.run(10s);
    const bool is_well = world.has_session(0) && world.actors(0) == std::vector<int>{3};
    if (!is_well && std::getenv("SLAMGW_STORY")) std::cerr << seed << '\n' << world.describe();
    lost += is_well ? 0 : 1;
  }
  EXPECT_EQ(lost, 0) << "of 40 robots";
}

TEST(Ownership, RobotOfADeadGatewayHasANewOwnerWithinTwoSeconds) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  world.kill(0);
  world.roam(0, 1);
  world.run(2s);
  EXPECT_EQ(world.actors(0), std::vector<int>{1});
}

TEST(Ownership, ARoamCostsTwoMessagesAndACommandOne) {
  FleetWorld world({.gateways = 3, .robots = 1, .doubled = 0});
  world.run(5s);
  const auto before = world.published();
  const auto beats = world.published_by_kind("beat");
  world.roam(0, 1);
  world.run(2s);
  EXPECT_EQ(world.published() - before - (world.published_by_kind("beat") - beats), 2U);
  world.command(0);
  world.run(5s);
  EXPECT_EQ(world.published_by_kind("taken"), 1U);
  EXPECT_LE(world.published_by_kind("beat") - beats, 3U * 2U * 7U + 3U);
}

TEST(Ownership, PausedGatewayActsForNobodyWhenItGoesOn) {
  FleetWorld world({.gateways = 2, .robots = 2});
  world.run(5s);
  world.pause(0);
  world.roam(0, 1);
  world.run(60s);
  world.command(0);
  world.run(1s);
  world.resume(0);
  world.run(5s);
  EXPECT_EQ(world.actors(0), std::vector<int>{1});
  const auto all = world.judge();
  EXPECT_EQ(all.two_owners + all.doubled_commands + all.doubled_outcomes + all.false_wills, 0);
}

TEST(Ownership, TwoRobotsWithOneNameAreToldAndDoNotFlood) {
  FleetWorld world({.gateways = 2, .robots = 1});
  world.run(5s);
  const auto before = world.published_by_kind("claim");
  for (int step = 0; step < 600; ++step) {  // for two minutes, five times a second
    world.roam(0, step % 2);
    world.run(200ms);
  }
  EXPECT_LE(world.published_by_kind("claim") - before, 24U);
  EXPECT_NE(world.describe().find("two robots with this name"), std::string::npos);
}

TEST(Ownership, ForgedClaimsOfUnknownGatewaysAreVoid) {
  FleetWorld world({.gateways = 2, .robots = 1});
  world.run(5s);
  world.forge(
      "p/fleet/all/evil",
      R"({"v":1,"b":"0000000000010000","k":"claim","robot":"r o.b*0","epoch":99,"from":""})");
  world.forge(
      "p/fleet/all/gw-0",  // the right gateway, in a life that is not its own
      R"({"v":1,"b":"0000000000010000","k":"claim","robot":"r o.b*0","epoch":99,"from":""})");
  world.forge("p/fleet/all/gw-0", "no JSON");
  world.forge("p/fleet/all/gw-1", std::string(1'000'000, '['));
  world.forge("p/fleet/to/gw-1/gw-0", R"({"v":1,"b":"0","k":"table"})");
  world.run(3s);
  EXPECT_EQ(world.actors(0), std::vector<int>{0});
}

TEST(Ownership, ServesItsRobotsWhenTheBrokerForbidsTheFleet) {
  FleetWorld world({.gateways = 2, .robots = 2, .enabled = Enabled::automatic});
  world.forbid_fleet();
  world.run(30s);
  EXPECT_TRUE(world.ownership(0).is_alone());
  EXPECT_TRUE(world.ownership(1).is_alone());
  EXPECT_EQ(world.actors(0), (std::vector<int>{0, 1}));  // as before there were fleets
}

TEST(Ownership, TheProbeOfAnotherGatewayIsNoCommand) {
  FleetWorld world({.gateways = 2, .robots = 1});
  world.run(5s);
  world.forge("p/server/gw-0/probe", "1-1");
  world.run(10s);
  EXPECT_EQ(world.published_by_kind("taken"), 0U);
}

TEST(Ownership, RobotMayBeNamedAsAGateway) {
  const FleetTopics topics("p", "gw-0");
  EXPECT_EQ(topics.all(), "p/fleet/all/gw-0");  // robots' names are in no topic of the fleet
  EXPECT_EQ(topics.sender("p/fleet/to/gw-0/gw-1"), "gw-1");
  EXPECT_FALSE(topics.sender("p/fleet/to/gw-1/gw-0"));
}

}  // namespace
}  // namespace slamgw::fleet::test
