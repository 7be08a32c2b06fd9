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

TEST_F(RobotSessionRulesUp, SubscribesAgainWhenTheBrokerDoesNotAnswer) {
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", false, now);
  sessions.subscribe("r1", "a/answered", Qos::at_least_once, false, now);
  sessions.subscribe("r1", "a/silent", Qos::at_least_once, false, now);
  sessions.on_subscribed("r1", "a/answered", true, now);
  for (int times = 0; times < 3; ++times) {
    forget_actions();
    pass(RobotSession::longest_answer);
    EXPECT_EQ(subscribed(), std::vector<std::string>{"a/silent"});
  }
  sessions.on_subscribed("r1", "a/silent", true, now);
  forget_actions();
  pass(RobotSession::longest_answer);
  EXPECT_EQ(subscribed(), std::vector<std::string>{});
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

// --- Refused subscriptions -----------------------------------------------------------------------

const std::string own_filter = "ntnu-slam/server/r1/#";

class RefusedSubscriptions : public RobotSessionRules, public testing::WithParamInterface<bool> {
 protected:
  RefusedSubscriptions() { sessions.on_broker_up(/*is_v5=*/GetParam(), /*is_other=*/false, now); }
};

INSTANTIATE_TEST_SUITE_P(EachVersion, RefusedSubscriptions, testing::Bool(),
                         [](const auto& each) { return each.param ? "Mqtt5" : "Mqtt311"; });

/// A broker that has just started, or lacks room, may refuse what it granted before.
TEST_P(RefusedSubscriptions, AreAskedForAgainAfterWaitsThatDouble) {
  resume(all_commands);
  attach();
  seconds wait = RobotSession::first_ask_wait;
  for (int round = 0; round < 8; ++round) {
    grants(all_commands, false);
    EXPECT_TRUE(drain<FilterAnswered>().empty());
    pass(wait - milliseconds{1});
    EXPECT_TRUE(subscribed().empty()) << wait.count();
    pass(milliseconds{1});
    EXPECT_EQ(subscribed(), std::vector{all_commands}) << wait.count();
    wait = std::min(2 * wait, RobotSession::longest_ask_wait);
  }
  EXPECT_EQ(wait, RobotSession::longest_ask_wait);
  grants(all_commands);
  grants(all_commands, false);
  forget_actions();
  pass(RobotSession::first_ask_wait);
  EXPECT_EQ(subscribed(), std::vector{all_commands}) << "the wait starts again after a grant";
}

TEST_P(RefusedSubscriptions, ShareOneWait) {
  const std::string updates = "ntnu-slam/robot/+/update";
  for (const std::string& filter : {all_commands, updates}) resume(filter);
  attach();
  grants(updates, false);
  pass(milliseconds{500});
  grants(all_commands, false);
  grants(mailbox, false);
  forget_actions();
  pass(milliseconds{500});
  EXPECT_EQ(subscribed(), (std::vector{mailbox, updates, all_commands}));
  for (const std::string& granted : {mailbox, updates}) grants(granted);
  grants(all_commands, false);
  forget_actions();
  pass(2 * RobotSession::first_ask_wait);
  EXPECT_EQ(subscribed(), std::vector{all_commands});
}

/// The robot got its SUBACK while the broker had not answered, so it does not ask again.
TEST_P(RefusedSubscriptions, StayWhenTheRefusalComesAfterTheRobotsAnswer) {
  attach();
  subscribe(all_commands);
  forget_actions();
  pass(RobotSession::subscribe_patience);
  const auto answers = drain<FilterAnswered>();
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_TRUE(answers[0].is_granted);
  grants(all_commands, false);
  EXPECT_TRUE(drain<FilterAnswered>().empty());
  pass(RobotSession::first_ask_wait);
  const auto asked = drain<SubscribeSession>();
  ASSERT_EQ(asked.size(), 1U);
  EXPECT_TRUE(asked[0].wants_retained) << "the robot has not had them";
}

/// A Thread robot hears the refusal, and its mesh unsubscribes. A BLE robot has not asked itself.
TEST_P(RefusedSubscriptions, OfARobotThatWaitsAreAnsweredAndStayUntilItsMeshUnsubscribes) {
  attach();
  for (const bool is_thread : {false, true}) {
    subscribe(all_commands);
    forget_actions();
    grants(all_commands, false);
    const auto answers = drain<FilterAnswered>();
    ASSERT_EQ(answers.size(), 1U);
    EXPECT_FALSE(answers[0].is_granted);
    if (is_thread) sessions.unsubscribe("r1", all_commands);
    forget_actions();
    pass(RobotSession::longest_ask_wait);
    EXPECT_EQ(subscribed(), is_thread ? std::vector<std::string>{} : std::vector{all_commands});
  }
}

TEST_P(RefusedSubscriptions, AreAskedForOnceOnANewConnection) {
  resume(all_commands);
  attach();
  grants(all_commands, false);
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  forget_actions();
  sessions.on_attached("r1", /*is_present=*/true, now);
  EXPECT_EQ(subscribed(), (std::vector{mailbox, all_commands}));
  pass(RobotSession::longest_answer - seconds{1});
  EXPECT_TRUE(subscribed().empty()) << "the broker has not answered yet";
}

TEST_P(RefusedSubscriptions, OfACleanedRobotAreForgotten) {
  resume(all_commands);
  attach();
  grants(all_commands, false);
  sessions.begin_clean("r1", now);
  forget_actions();
  pass(RobotSession::longest_ask_wait);
  EXPECT_TRUE(subscribed().empty());
}

TEST_P(RefusedSubscriptions, OfManyRobotsAreOneWarningAndOneNotice) {
  const std::vector<std::string> robots{"r1", "r2", "r3"};
  const auto filter_of = [](const std::string& robot) {
    return "ntnu-slam/server/" + robot + "/+";
  };
  for (const std::string& robot : robots) {
    sessions.subscribe(robot, filter_of(robot), Qos::at_least_once, true, now);
    sessions.on_heard(robot, now);
    sessions.on_attached(robot, false, now);
  }
  for (int burst = 0; burst < 2; ++burst) {
    forget_actions();
    for (int round = 0; round < 3; ++round)
      for (const std::string& robot : robots)
        sessions.on_subscribed(robot, filter_of(robot), false, now);
    auto said = drain<Notice>();
    ASSERT_EQ(said.size(), 1U);
    EXPECT_EQ(said[0].severity, Severity::warning);
    EXPECT_NE(said[0].text.find("ntnu-slam/server/r1/+"), std::string::npos) << said[0].text;
    EXPECT_EQ(sessions.refused_filter("r2"), "ntnu-slam/server/r2/+");
    for (const std::string robot : {"r1", "r2"})
      sessions.on_subscribed(robot, filter_of(robot), true, now);
    EXPECT_TRUE(drain<Notice>().empty()) << "r3 is still refused";
    for (int twice = 0; twice < 2; ++twice)
      sessions.on_subscribed("r3", filter_of("r3"), true, now);
    said = drain<Notice>();
    ASSERT_EQ(said.size(), 1U);
    EXPECT_EQ(said[0].severity, Severity::notice);
    EXPECT_EQ(sessions.refused_filter("r3"), std::nullopt);
  }
}

TEST_F(RobotSessionRulesUp, AsksAgainForTheGatewaysOwnFilterWhileTheRobotHasNoneForAllCommands) {
  attach();
  grants(own_filter, false);
  forget_actions();
  pass(RobotSession::first_ask_wait);
  EXPECT_EQ(subscribed(), std::vector{own_filter});
  grants(own_filter, false);
  EXPECT_EQ(sessions.refused_filter("r1"), own_filter);
  subscribed_id(all_commands);
  pass(RobotSession::longest_ask_wait);
  EXPECT_TRUE(subscribed().empty());
  EXPECT_EQ(sessions.refused_filter("r1"), std::nullopt);
}

}  // namespace
}  // namespace slamgw::sessions
