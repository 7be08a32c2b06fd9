// SPDX-License-Identifier: Apache-2.0
// What a gateway does until it knows who else is about, and when it is alone again.
#include "tests/fleet/newcomer.hpp"
#include "tests/fleet/will_of.hpp"

#include <array>
#include <set>

namespace slamgw::fleet::test {
namespace {

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

TEST_F(Newcomer, WarnsWhenTheBrokerLetsNothingThroughUnderFleet) {
  ownership.on_broker_link(true, at(0s));
  state_comes("gw-1", 0s);
  for (Duration after{}; after < 12s; after += 100ms) ownership.on_deadline(at(after));
  std::vector<Notice> warnings;
  while (const auto action = ownership.next_action()) {
    const auto* notice = std::get_if<Notice>(&*action);
    if (notice && notice->severity == Severity::warning) warnings.push_back(*notice);
  }
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_NE(warnings[0].text.find("topic write p/fleet/all/gw-0"), std::string::npos);
  EXPECT_EQ(ownership.missing_rights(at(12s).mono).size(), 1U);
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

/// The sessions of an earlier process are over here; their robots may live at other gateways.
class NewcomerWithAWill : public Newcomer {
 protected:
  void will_is_due(Duration after) { ownership.on_will(will_of("r"), at(after)); }
  std::size_t published() {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      count += std::holds_alternative<PublishWill>(*action) ? 1 : 0;
    return count;
  }
};

TEST_F(NewcomerWithAWill, WaitsUntilTheBrokerHasToldThatItIsAlone) {
  will_is_due(0s);
  ownership.on_broker_link(true, at(1s));
  will_is_due(2s);
  ownership.on_broker_link(false, at(3s));  // before it has answered
  will_is_due(4s);
  EXPECT_EQ(published(), 0U);
  ownership.on_broker_link(true, at(5s));
  states_answered(6s);
  ownership.on_deadline(at(7s));
  EXPECT_EQ(published(), 3U);
  will_is_due(8s);
  EXPECT_EQ(published(), 1U) << "it is alone";
}

TEST_F(NewcomerWithAWill, AsksTheOthersThatItFinds) {
  will_is_due(0s);
  ownership.on_broker_link(true, at(1s));
  state_comes("gw-1", 2s);
  ASSERT_EQ(ownership.phase(), Ownership::Phase::joining);
  EXPECT_EQ(published(), 0U);
}

TEST_F(NewcomerWithAWill, KeepsItFromNobodyWhenTheRobotIsBackOrTheDaemonEnds) {
  will_is_due(0s);
  EXPECT_TRUE(ownership.is_holding_wills());
  ownership.on_heard("r", at(1s));
  EXPECT_FALSE(ownership.is_holding_wills());
  will_is_due(2s);
  ownership.on_stop();
  EXPECT_EQ(published(), 1U) << "for the store";
  will_is_due(3s);
  EXPECT_EQ(published(), 1U);
}

/// Nothing that it writes under fleet/ comes back, so that it goes on alone.
TEST_F(Newcomer, DecidesWhatWaitedWhenItFallsAsleep) {
  ownership.on_broker_link(true, at(0s));
  states_answered(10ms);
  state_comes("gw-1", 20ms);
  ASSERT_EQ(ownership.phase(), Ownership::Phase::joining);
  command(9s);
  ownership.on_will(will_of("r"), at(9s));
  ownership.on_own_outcome({"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false}, 1s,
                           at(9s));
  const auto decided = [&] {
    std::array<std::size_t, 3> count{};
    while (const auto action = ownership.next_action()) {
      count[0] += std::holds_alternative<CarryOut>(*action) ? 1 : 0;
      count[1] += std::holds_alternative<PublishWill>(*action) ? 1 : 0;
      count[2] += std::holds_alternative<PublishOutcome>(*action) ? 1 : 0;
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

TEST_F(Newcomer, HoldsTheWillsOfABoundedNumberOfRobots) {
  ownership.on_broker_link(true, at(0s));
  const auto published = [&] {
    std::size_t count = 0;
    while (const auto action = ownership.next_action())
      count += std::holds_alternative<PublishWill>(*action) ? 1 : 0;
    return count;
  };
  for (std::size_t robot = 0; robot < PendingWills::max_robots; ++robot) {
    ownership.on_will(will_of(std::to_string(robot)), at(1ms));
  }
  EXPECT_EQ(published(), 0U);
  ownership.on_will(will_of("one more"), at(1ms));
  EXPECT_EQ(published(), 1U);
}

/// Others may have carried it out while the broker was silent to this gateway only.
TEST_F(Newcomer, HoldsCommandsOverAConnectionThatHasToldNothing) {
  ownership.on_broker_link(true, at(0s));
  command(10ms);
  ownership.on_broker_link(false, at(20ms));
  EXPECT_EQ(carried_out(), 0U);
  EXPECT_FALSE(ownership.is_shared());
  ownership.on_broker_link(true, at(3s));
  states_answered(3s);
  ownership.on_deadline(at(5s));
  EXPECT_EQ(carried_out(), 1U);
}

TEST_F(Newcomer, HoldsNothingWhenTheBrokerGoesThatHasToldWhoIsAbout) {
  ownership.on_broker_link(true, at(0s));
  states_answered(0s);
  ownership.on_deadline(at(2s));
  ownership.on_broker_link(false, at(3s));
  ownership.on_broker_link(true, at(4s));
  command(4s);
  ownership.on_broker_link(false, at(4010ms));
  EXPECT_EQ(carried_out(), 1U);
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
  others_answered(10ms);
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
      count += std::holds_alternative<PublishOutcome>(*action) ? 1 : 0;
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
  EXPECT_TRUE(std::holds_alternative<PublishOutcome>(*action));
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

}  // namespace
}  // namespace slamgw::fleet::test
