// SPDX-License-Identifier: Apache-2.0
// A robot's session: its subscriptions, answers to the robot, and its note.
#include "tests/sessions/session_rules.hpp"

namespace slamgw::sessions {
namespace {

// --- Subscriptions -------------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, SubscribesTheRobotsFiltersWhenItsSessionIsNew) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, false, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", false, now);
  std::vector<std::string> filters;
  for (const auto& each : drain<SubscribeSession>()) filters.push_back(each.filter);
  EXPECT_EQ(filters, (std::vector<std::string>{"ntnu-slam/fleet/robots/r1/waiting",
                                               "ntnu-slam/server/r1/+"}));
  sessions.on_subscribed("r1", "ntnu-slam/server/r1/+", true, now);
  const auto answers = drain<FilterAnswered>();
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_TRUE(answers[0].is_granted);
}

/// A broker that was killed may have an older session, and a gateway that was killed may have made
/// one without all of the robot's filters.
TEST_F(RobotSessionRulesUp, RenewsSubscriptionsThatThePresentSessionShouldHave) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, true, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(subscribed(), (std::vector{mailbox, std::string("ntnu-slam/server/r1/+")}));
  sessions.on_subscribed("r1", "ntnu-slam/server/r1/+", true, now);
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  forget_actions();
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(subscribed(), (std::vector{mailbox, std::string("ntnu-slam/server/r1/+")}));
}

/// The broker sends such a command for the gateway's filter alone.
TEST_F(RobotSessionRulesUp, TakesACommandForAFilterThatItsSessionMayLackAsUnasked) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/run", Qos::at_least_once, true, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  forget_actions();
  const std::uint32_t by_gateway[] = {RobotSession::command_id};
  sessions.on_message("r1", {"ntnu-slam/server/r1/run", to_bytes("start"), Qos::at_least_once},
                      by_gateway, now);
  const auto taken = fenced();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_TRUE(taken[0].is_unasked);
}

TEST_F(RobotSessionRulesUp, RenewsSubscriptionsWhenTheBrokerLostTheSession) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, true, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", false, now);
  EXPECT_EQ(drain<SubscribeSession>().back().filter, "ntnu-slam/server/r1/+");
}

TEST_F(RobotSessionRulesUp, UnsubscribesLaterWhatTheRobotUnsubscribedWhileDetached) {
  sessions.subscribe("r1", "ntnu-slam/robot/+/update", Qos::at_least_once, true, now);
  attach(true);
  sessions.on_detached("r1", now);
  sessions.unsubscribe("r1", "ntnu-slam/robot/+/update");
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(drain<UnsubscribeSession>().size(), 1U);
}

/// The session may have filters that this gateway does not know, unless the broker has just made
/// it.
TEST_F(RobotSessionRulesUp, NewSessionWantsOnlyTopicsThatItsRobotHasSubscribedTo) {
  const std::string topic = "ntnu-slam/server/r1/cmd";
  sessions.on_heard("r1", now);
  EXPECT_TRUE(sessions.may_want("r1", topic)) << "unknown so far";
  sessions.on_attached("r1", /*is_present=*/true, now);
  EXPECT_TRUE(sessions.may_want("r1", topic));
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", /*is_present=*/false, now);
  EXPECT_FALSE(sessions.may_want("r1", topic));
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, false, now);
  EXPECT_TRUE(sessions.may_want("r1", topic));
  sessions.unsubscribe("r1", "ntnu-slam/server/r1/+");
  EXPECT_FALSE(sessions.may_want("r1", topic));
}

TEST_F(RobotSessionRulesUp, CleanConnectRefusesWaitingCommandsAndOpensACleanSession) {
  sessions.subscribe("r1", "ntnu-slam/robot/+/update", Qos::at_least_once, false, now);
  sessions.on_heard("r1", now);
  forget_actions();
  sessions.on_detached("r1", now);
  sessions.begin_clean("r1", now);
  pass(seconds{1});
  sessions.on_attached("r1", true, now);
  for (unsigned round = 0; round < RobotSession::marker_rounds; ++round) {
    const auto markers = drain<SendMarker>();
    ASSERT_EQ(markers.size(), 1U);
    arrives(command("1"));
    fenced();
    arrives({mailbox, to_bytes(markers[0].text), Qos::at_least_once, false});
  }
  const auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_TRUE(opened[0].is_clean);
  sessions.on_attached("r1", false, now);
  EXPECT_EQ(subscribed(), (std::vector<std::string>{mailbox, "ntnu-slam/server/r1/#"}));
}

TEST_F(RobotSessionRulesUp, SortsAgainAfterACleanConnectThatFailed) {
  sessions.begin_clean("r1", now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  pass(RobotSession::marker_patience);
  ASSERT_TRUE(drain<OpenSession>().back().is_clean);
  sessions.on_attach_failed("r1", now);
  pass(RobotSession::longest_retry);
  const auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_FALSE(opened[0].is_clean) << "commands may have come in between";
  sessions.on_attached("r1", true, now);
  arrives(command("1"));
  std::size_t stale = 0;
  while (auto action = sessions.next_action()) {
    if (const auto* fence = std::get_if<AskFence>(&*action))
      sessions.on_fence("r1", fence->number, now);
    stale += std::holds_alternative<RefuseStale>(*action) ? 1 : 0;
  }
  EXPECT_EQ(stale, 1U);
}

TEST_F(RobotSessionRulesUp, ForgetsTheFiltersOfARobotThatItHasGivenUp) {
  subscribe("ntnu-slam/server/r1/run");
  attach(true);
  sessions.on_given_up("r1");
  sessions.on_detached("r1", now);
  sessions.on_given_up("r1");
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(subscribed(), (std::vector<std::string>{mailbox, "ntnu-slam/server/r1/#"}));
}

TEST_F(RobotSessionRulesUp, UnsubscribesAgainUntilTheBrokerHasAnswered) {
  const std::string updates = "ntnu-slam/robot/+/update";
  resume(updates);
  attach(true);
  sessions.unsubscribe("r1", updates);
  for (int loss = 0; loss < 2; ++loss) {
    forget_actions();
    sessions.on_detached("r1", now);
    sessions.on_heard("r1", now);
    pass(RobotSession::longest_flap_wait);
    sessions.on_attached("r1", true, now);
    std::vector<std::string> gone;
    std::uint64_t fence = 0;
    while (auto action = sessions.next_action()) {
      if (const auto* it = std::get_if<UnsubscribeSession>(&*action)) gone.push_back(it->filter);
      if (const auto* it = std::get_if<AskFence>(&*action)) fence = it->number;
    }
    EXPECT_EQ(gone, std::vector<std::string>{updates});
    if (loss == 1) sessions.on_fence("r1", fence, now);
  }
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  pass(RobotSession::longest_flap_wait);
  sessions.on_attached("r1", true, now);
  EXPECT_TRUE(drain<UnsubscribeSession>().empty());
}

/// The other broker may have an older session of the robot, with that filter.
TEST_F(RobotSessionRules, UnsubscribesAtAnotherBrokerWhatTheRobotUnsubscribedBefore) {
  const std::string updates = "ntnu-slam/robot/+/update";
  resume(updates);
  sessions.unsubscribe("r1", updates);
  sessions.on_broker_up(/*is_v5=*/true, /*is_other=*/true, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", /*is_present=*/true, now);
  const auto given_up = drain<UnsubscribeSession>();
  ASSERT_EQ(given_up.size(), 1U);
  EXPECT_EQ(given_up[0].filter, updates);
}

TEST_F(RobotSessionRulesUp, WaitsForTheSubackOfABrokerThatAnswersAgain) {
  attach();
  sessions.on_silence(true);
  sessions.on_broker_down(now);
  sessions.on_broker_up(/*is_v5=*/true, /*is_other=*/false, now);
  attach();
  subscribe("ntnu-slam/server/r1/+");
  EXPECT_TRUE(drain<FilterAnswered>().empty());
  grants("ntnu-slam/server/r1/+", false);
  ASSERT_EQ(drain<FilterAnswered>().size(), 1U);
}

/// An UNSUBSCRIBE from the note may be lost with its connection.
TEST_F(RobotSessionRulesUp, ReadsTheRetainedNoteAndIgnoresOneThatWaitedInTheSession) {
  sessions.read_note("r1", now);
  sessions.on_attached("r1", /*is_present=*/true, now);
  arrives({note_topic, to_bytes("old"), Qos::at_least_once, /*retain=*/false});
  EXPECT_TRUE(drain<NoteRead>().empty());
  arrives({note_topic, to_bytes("new"), Qos::at_least_once, /*retain=*/true});
  const auto read = drain<NoteRead>();
  ASSERT_EQ(read.size(), 1U);
  EXPECT_EQ(read[0].note, to_bytes("new"));
}

TEST_F(RobotSessionRulesUp, TellsANoteThatCannotBeReadFromOneThatIsNotThere) {
  sessions.read_note("r1", now);
  sessions.on_attached("r1", /*is_present=*/false, now);
  auto read = drain<NoteRead>();
  ASSERT_EQ(read.size(), 1U);
  EXPECT_EQ(read[0].note, Bytes{});
  sessions.read_note("r1", now);
  sessions.on_broker_down(now);
  read = drain<NoteRead>();
  ASSERT_EQ(read.size(), 1U);
  EXPECT_FALSE(read[0].note) << "the broker went while the note was read";
  sessions.read_note("r1", now);
  read = drain<NoteRead>();
  ASSERT_EQ(read.size(), 1U);
  EXPECT_FALSE(read[0].note) << "the broker is away";
}

/// The robot's first CONNECT was dropped when another gateway took the session.
TEST_F(RobotSessionRulesUp, TakesTheSessionAgainForTheNoteOfARobotThatConnectsAgain) {
  sessions.read_note("r1", now);
  sessions.on_attached("r1", /*is_present=*/true, now);
  sessions.on_detached("r1", now);
  forget_actions();
  pass(seconds{1});
  sessions.read_note("r1", now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_attached("r1", /*is_present=*/true, now);
  arrives({note_topic, to_bytes("new"), Qos::at_least_once, /*retain=*/true});
  const auto read = drain<NoteRead>();
  ASSERT_EQ(read.size(), 1U);
  EXPECT_EQ(read[0].note, to_bytes("new"));
}

TEST_F(RobotSessionRulesUp, ResubscribesTheGatewaysFilterAfterTheRobotUnsubscribesTheSame) {
  const std::string everything = "ntnu-slam/server/r1/#";
  resume(everything);
  attach(true);
  sessions.on_detached("r1", now);
  sessions.unsubscribe("r1", everything);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  std::vector<std::string> order;
  while (auto action = sessions.next_action()) {
    const auto* it = std::get_if<SubscribeSession>(&*action);
    if (it && it->filter == everything) order.emplace_back("subscribe");
    if (std::holds_alternative<UnsubscribeSession>(*action)) order.emplace_back("unsubscribe");
  }
  EXPECT_EQ(order, (std::vector<std::string>{"unsubscribe", "subscribe"}));
}

}  // namespace
}  // namespace slamgw::sessions
