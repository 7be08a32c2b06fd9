// SPDX-License-Identifier: Apache-2.0
// Which messages of a robot's session this gateway takes, and which it refuses.
#include "tests/sessions/session_rules.hpp"

namespace slamgw::sessions {
namespace {

// --- Rule 2: the fence ---------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule2_TakesACommandWhenItsFenceIsAnswered) {
  attach();
  arrives(command("1"));
  const auto fences = drain<AskFence>();
  ASSERT_EQ(fences.size(), 1U);
  now.mono += milliseconds{3};
  sessions.on_fence("r1", fences[0].number, now);
  const auto taken = drain<TakeMessage>();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_EQ(as_text(taken[0].message.payload), "1");
  EXPECT_EQ(taken[0].message.waited, Waited{3}) << "it counts against the 30 s";
}

TEST_F(RobotSessionRulesUp, Rule2_TakesNoCommandWhoseFenceIsNotAnsweredOnItsConnection) {
  attach();
  arrives(command("1"));
  const auto fence = drain<AskFence>().at(0).number;
  sessions.on_detached("r1", now);
  sessions.on_fence("r1", fence, now);
  EXPECT_TRUE(drain<TakeMessage>().empty());
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  sessions.on_fence("r1", fence, now);
  EXPECT_TRUE(drain<TakeMessage>().empty()) << "nor on the next connection";
}

TEST_F(RobotSessionRulesUp, Rule2_CommandsAreTakenInTheirOrder) {
  attach();
  arrives(command("1"));
  arrives(command("2"));
  const auto fences = drain<AskFence>();
  sessions.on_fence("r1", fences.at(1).number, now);
  const auto taken = drain<TakeMessage>();
  ASSERT_EQ(taken.size(), 2U);
  EXPECT_EQ(as_text(taken[0].message.payload), "1");
}

/// The broker may have dropped the command already, so the next process would not get it.
TEST_F(RobotSessionRulesUp, ClosesASessionAtTheStopOnlyWhenItsFencesAreAnswered) {
  attach();
  arrives(command("1"));
  const auto fence = drain<AskFence>().at(0).number;
  sessions.on_stop();
  EXPECT_TRUE(drain<CloseSession>().empty());
  sessions.on_fence("r1", fence, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
  sessions.on_stop();
  EXPECT_EQ(drain<CloseSession>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, MessagesWithoutAFenceAreBounded) {
  attach();
  for (std::size_t i = 0; i < 2 * RobotSession::max_unfenced; ++i) arrives(command("1"));
  EXPECT_EQ(drain<AskFence>().size(), RobotSession::max_unfenced);
}

// --- Rule 7: commands that waited too long -------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule7_RefusesStaleCommandsThatWaitedWhileNoGatewayHeldTheSession) {
  sessions.keep("r1", now.mono - seconds{26}, seconds{5}, now);
  pass(seconds{5});
  ASSERT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_attached("r1", true, now);
  const auto markers = drain<SendMarker>();
  ASSERT_EQ(markers.size(), 1U);
  arrives(command("old"));
  sessions.on_fence("r1", 1, now);
  const auto stale = drain<RefuseStale>();
  ASSERT_EQ(stale.size(), 1U);
  EXPECT_EQ(as_text(stale[0].message.payload), "old");
  arrives({mailbox, to_bytes(markers[0].text), Qos::at_least_once, false});
  const auto last = drain<SendMarker>();
  ASSERT_EQ(last.size(), 1U);
  arrives(command("old, with QoS 2"));
  sessions.on_fence("r1", 2, now);
  EXPECT_EQ(drain<RefuseStale>().size(), 1U);
  arrives({mailbox, to_bytes(last[0].text), Qos::at_least_once, false});
  arrives(command("new"));
  sessions.on_fence("r1", 3, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_RefusesStaleCommandsBeyondTheBoundOfUnfencedMessages) {
  sessions.keep("r1", now.mono - seconds{60}, {}, now);
  pass({});
  sessions.on_attached("r1", true, now);
  forget_actions();
  std::size_t refused = 0;
  for (std::uint64_t i = 1; i <= 3 * RobotSession::max_unfenced; ++i) {
    arrives(command("old"));
    sessions.on_fence("r1", i, now);
    refused += drain<RefuseStale>().size();
  }
  EXPECT_EQ(refused, 3 * RobotSession::max_unfenced);
}

TEST_F(RobotSessionRulesUp, Rule7_TakesCommandsAgainWhenTheMarkerDoesNotReturn) {
  sessions.keep("r1", now.mono - seconds{60}, {}, now);
  pass({});
  sessions.on_attached("r1", true, now);
  forget_actions();
  pass(RobotSession::marker_patience);
  arrives(command("new"));
  EXPECT_EQ(fenced().size(), 1U);
}

/// The gateway for which a command was put there may have died before it took it.
TEST_F(RobotSessionRulesUp, Rule7_RefusesStaleCommandsFromTheMailbox) {
  sessions.keep("r1", now.mono - seconds{60}, {}, now);
  pass({});
  sessions.on_attached("r1", true, now);
  forget_actions();
  arrives({mailbox, encode_waiting({command("old"), CommandId{7}}), Qos::at_least_once, false});
  sessions.on_fence("r1", 1, now);
  const auto stale = drain<RefuseStale>();
  ASSERT_EQ(stale.size(), 1U);
  EXPECT_EQ(as_text(stale[0].message.payload), "old");
}

TEST_F(RobotSessionRulesUp, Rule7_DatesALossNoticedAfterAStandstillFromItsBeginning) {
  attach(true);
  sessions.on_tick(now.mono);
  forget_actions();
  now.mono += std::chrono::minutes{10};
  sessions.on_detached("r1", now);
  sessions.on_tick(now.mono);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(drain<SendMarker>().size(), 1U) << "waiting commands may be ten minutes old";
}

TEST_F(RobotSessionRulesUp, Rule7_ARetainedMessageIsNotStale) {
  sessions.keep("r1", now.mono - seconds{60}, {}, now);
  subscribe("ntnu-slam/server/r1/run");
  pass({});
  sessions.on_attached("r1", true, now);
  forget_actions();
  BrokerMessage retained = command("1");
  retained.retain = true;
  arrives(retained);
  EXPECT_EQ(fenced().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_TakesCommandsThatWaitedForAShortTime) {
  sessions.keep("r1", now.mono - seconds{3}, seconds{5}, now);
  pass(seconds{5});
  sessions.on_attached("r1", true, now);
  EXPECT_TRUE(drain<SendMarker>().empty());
  arrives(command("1"));
  sessions.on_fence("r1", 1, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_TakesRecentCommandsOfARobotHeardBeforeItsConnectIsDue) {
  now.mono += std::chrono::hours{5};
  sessions.keep("r1", now.mono, seconds{5}, now);
  now.mono += seconds{2};
  attach(true);
  arrives(command("1"));
  EXPECT_EQ(fenced().size(), 1U) << "its gateway died two seconds ago";
}

/// After an outage, a gateway that is back first takes the others for dead.
TEST_F(RobotSessionRulesUp, Rule7_TakesRecentCommandsOfARobotWhoseGatewayIsBackLater) {
  now.mono += std::chrono::hours{5};
  sessions.keep("r1", now.mono, seconds{5}, now);
  now.mono += seconds{8};
  sessions.keep("r1", now.mono - 2 * RobotSession::stale_after, seconds{5}, now);
  attach(true);
  arrives(command("1"));
  EXPECT_EQ(fenced().size(), 1U) << "its gateway was online eight seconds ago";
}

TEST_F(RobotSessionRulesUp, Rule7_RefusesCommandsThatMayHaveWaitedSinceTheStartOfTheProcess) {
  now.mono += seconds{26};
  attach(true);
  arrives(command("1"));
  EXPECT_TRUE(fenced().empty());
}

TEST_F(RobotSessionRules, Rule7_SortsTheFirstSessionWithoutAFormerProcess) {
  RobotSessions fresh{SessionNames(TopicScheme("ntnu-slam", "pi1")),
                      [](const std::string&) { return false; }};
  fresh.on_broker_up(true, false, now);
  fresh.on_heard("r1", now);
  fresh.on_attached("r1", true, now);
  bool has_marker = false;
  while (auto action = fresh.next_action())
    has_marker = has_marker || std::holds_alternative<SendMarker>(*action);
  EXPECT_TRUE(has_marker);
}

/// The broker of the list that is up first need not be the one of the former process.
TEST_F(RobotSessionRules, Rule7_SortsSessionsAtABrokerThatTheFormerProcessDidNotUse) {
  resume("ntnu-slam/server/r1/run");
  sessions.on_broker_up(/*is_v5=*/true, /*is_other=*/true, now);
  for (const char* const robot : {"r1", "heard later"}) {
    sessions.on_heard(robot, now);
    sessions.on_attached(robot, /*is_present=*/true, now);
    EXPECT_EQ(drain<SendMarker>().size(), 1U) << robot;
  }
}

TEST_F(RobotSessionRulesUp, Rule7_TakesCommandsOfASessionThatALivingGatewayHeld) {
  now.mono += std::chrono::hours{5};
  is_served_elsewhere = true;
  attach(true);
  arrives(command("1"));
  EXPECT_EQ(fenced().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_RefusesStaleCommandsFromAfterTheLossOfTheSession) {
  now.mono += std::chrono::hours{5};
  for (const seconds away : {seconds{20}, seconds{30}}) {
    attach(true);
    pass(RobotSession::marker_patience);
    sessions.on_detached("r1", now);
    now.mono += away;
    attach(true);
    arrives(command("1"));
    EXPECT_EQ(fenced().size(), away < RobotSession::stale_after ? 1U : 0U);
    sessions.on_detached("r1", now);
  }
}

TEST_F(RobotSessionRulesUp, Rule7_OpensNoSessionOfARobotThatALivingGatewayShows) {
  sessions.keep("r1", now.mono, seconds{5}, now);
  is_served_elsewhere = true;
  pass(seconds{5});
  EXPECT_TRUE(drain<OpenSession>().empty());
}

// --- Rule 13: commands that the robot has not subscribed to --------------------------------------

TEST_F(RobotSessionRulesUp, Rule13_MarksACommandThatOnlyTheGatewaysFilterMatchedAsUnasked) {
  attach();
  subscribed_id("ntnu-slam/server/r1/cmd");
  arrives(command("1"), {RobotSession::command_id});
  const auto taken = fenced();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_TRUE(taken[0].is_unasked);
}

TEST_F(RobotSessionRulesUp, Rule13_TakesTheCopyForTheRobotsFilterOfTwoCopies) {
  attach();
  const auto id = subscribed_id("ntnu-slam/server/r1/+/#");
  for (const bool is_own_first : {false, true}) {
    arrives(command("1"), {is_own_first ? id : RobotSession::command_id});
    arrives(command("1"), {is_own_first ? RobotSession::command_id : id});
    const auto taken = fenced();
    ASSERT_EQ(taken.size(), 1U);
    EXPECT_FALSE(taken[0].is_unasked);
  }
}

TEST_F(RobotSessionRulesUp, Rule13_TakesTheCopyWithTheHighestQosOfTwoCopies) {
  attach();
  subscribe("ntnu-slam/server/r1/#", Qos::at_most_once);
  std::uint32_t low = 0;
  for (const auto& each : drain<SubscribeSession>())
    if (each.filter == "ntnu-slam/server/r1/#") low = each.id;
  grants("ntnu-slam/server/r1/#");
  const std::uint32_t high = subscribed_id("ntnu-slam/server/r1/run");
  for (const bool is_low_first : {true, false}) {
    arrives(command("1", is_low_first ? Qos::at_most_once : Qos::at_least_once),
            {is_low_first ? low : high});
    arrives(command("1", is_low_first ? Qos::at_least_once : Qos::at_most_once),
            {is_low_first ? high : low});
    const auto taken = fenced();
    ASSERT_EQ(taken.size(), 1U);
    EXPECT_EQ(taken[0].message.qos, Qos::at_least_once);
  }
}

/// Messages that waited at the broker arrive before its SUBACKs.
TEST_F(RobotSessionRulesUp, Rule13_TakesOneOfTheCopiesThatWaitedAtTheBroker) {
  std::vector<std::uint32_t> ids{RobotSession::command_id};
  attach(true);
  for (const char* const filter : {"run", "+/#", "run/#"})
    ids.push_back(subscribed_id(std::string("ntnu-slam/server/r1/") + filter));
  sessions.on_detached("r1", now);
  attach(true);
  for (int equal = 0; equal < 2; ++equal)
    for (const std::uint32_t id : ids) arrives(command("1"), {id});
  const auto taken = fenced();
  ASSERT_EQ(taken.size(), 2U) << "two equal commands, four copies of each";
  for (const auto& each : taken) EXPECT_FALSE(each.is_unasked);
}

/// A copy of QoS 2 arrives one round trip later, after the SUBACKs.
TEST_F(RobotSessionRulesUp, Rule13_TakesNoSecondCommandFromALaterCopyOfQos2) {
  attach();
  std::vector<std::string> filters;
  std::vector<std::uint32_t> ids;
  for (const char* const type : {"run", "run/#", "+/#"}) {
    filters.push_back(std::string("ntnu-slam/server/r1/") + type);
    subscribe(filters.back(), ids.empty() ? Qos::at_least_once : Qos::exactly_once);
    for (const auto& each : drain<SubscribeSession>())
      if (each.filter == filters.back()) ids.push_back(each.id);
    grants(filters.back());
  }
  ASSERT_EQ(ids.size(), 3U);
  for (const bool is_unasked_first : {false, true}) {
    sessions.on_detached("r1", now);
    attach(true);
    std::uint64_t fence = 0;
    std::size_t taken = 0;
    const auto round_trip = [&] {
      while (auto action = sessions.next_action()) {
        if (const auto* asked = std::get_if<AskFence>(&*action)) fence = asked->number;
        taken += std::holds_alternative<TakeMessage>(*action) ? 1 : 0;
      }
      sessions.on_fence("r1", fence, now);
    };
    if (is_unasked_first) arrives(command("1"), {RobotSession::command_id});
    arrives(command("1"), {ids[0]});
    for (const std::string& filter : filters) grants(filter);
    for (const std::uint32_t id : {ids[1], ids[2]}) {
      round_trip();
      arrives(command("1", Qos::exactly_once), {id});
      EXPECT_EQ(taken, 0U);
    }
    for (int i = 0; i < 3; ++i) round_trip();
    EXPECT_EQ(taken, 1U);
  }
}

/// The robot has moved here, and its note has not arrived yet.
TEST_F(RobotSessionRulesUp, Rule13_TakesOneOfTheCopiesForUnknownFilters) {
  attach(true);
  for (const std::uint32_t id : {70U, 80U, 90U}) arrives(command("1"), {id});
  EXPECT_EQ(fenced().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule13_TakesAnEqualCommandForANewFilterAsAnotherCommand) {
  attach(true);
  const auto first = subscribed_id("ntnu-slam/server/r1/+");
  arrives(command("1"), {first});
  subscribe("ntnu-slam/server/r1/run", Qos::exactly_once);
  std::uint32_t second = 0;
  std::uint64_t fence = 0;
  while (auto action = sessions.next_action()) {
    if (const auto* asked = std::get_if<SubscribeSession>(&*action)) second = asked->id;
    if (const auto* asked = std::get_if<AskFence>(&*action)) fence = asked->number;
  }
  grants("ntnu-slam/server/r1/run");
  arrives(command("1"), {second});
  arrives(command("1"), {first});
  sessions.on_fence("r1", fence, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
  sessions.on_fence("r1", fence + 2, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
}

/// Otherwise the next gateway gets the rest of the copies. The robot obeys twice, or the command
/// has two outcomes.
TEST_F(RobotSessionRulesUp, Rule2_TakesACommandWhenTheFencesOfAllItsCopiesAreAnswered) {
  attach();
  const auto wide = subscribed_id("ntnu-slam/server/r1/+");
  const auto narrow = subscribed_id("ntnu-slam/server/r1/run");
  for (const std::uint32_t other : {std::max(wide, narrow), RobotSession::command_id}) {
    SCOPED_TRACE(other);
    arrives(command("1"), {std::min(wide, narrow)});
    arrives(command("1"), {other});
    const auto fences = drain<AskFence>();
    ASSERT_EQ(fences.size(), 2U);
    sessions.on_fence("r1", fences[0].number, now);
    EXPECT_TRUE(drain<TakeMessage>().empty());
    sessions.on_fence("r1", fences[1].number, now);
    EXPECT_EQ(drain<TakeMessage>().size(), 1U);
  }
}

TEST_F(RobotSessionRulesUp, SubscribesCommandsAtQos1ForARobotThatAsksForQos0) {
  attach();
  subscribe("ntnu-slam/server/r1/run", Qos::at_most_once);
  subscribe("ntnu-slam/robot/+/update", Qos::at_most_once);
  const auto asked = drain<SubscribeSession>();
  ASSERT_EQ(asked.size(), 2U);
  EXPECT_EQ(asked[0].qos, Qos::at_least_once);
  EXPECT_EQ(asked[1].qos, Qos::at_most_once);
}

TEST_F(RobotSessionRulesUp, Rule13_MarksCopiesUnderWayAtACleanConnectAsOneUnaskedCommand) {
  attach();
  const auto id = subscribed_id("ntnu-slam/server/r1/run");
  sessions.begin_clean("r1", now);
  forget_actions();
  for (const bool is_own_first : {false, true}) {
    arrives(command("1"), {is_own_first ? id : RobotSession::command_id});
    arrives(command("1"), {is_own_first ? RobotSession::command_id : id});
    const auto taken = fenced();
    ASSERT_EQ(taken.size(), 1U);
    EXPECT_TRUE(taken[0].is_unasked);
  }
}

TEST_F(RobotSessionRulesUp, Rule13_TakesOneMessageThatCarriesBothFilterIds) {
  attach();
  const auto id = subscribed_id("ntnu-slam/server/r1/run");
  arrives(command("1"), {RobotSession::command_id, id});
  const auto taken = fenced();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_FALSE(taken[0].is_unasked);
}

}  // namespace
}  // namespace slamgw::sessions
