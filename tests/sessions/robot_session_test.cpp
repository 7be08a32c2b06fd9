// SPDX-License-Identifier: Apache-2.0
// When a gateway opens, retries, loses and forgets a robot's session.
#include <algorithm>

#include "daemon/sessions/robot_sessions.hpp"
#include "tests/sessions/session_rules.hpp"

namespace slamgw::sessions {
namespace {

TEST_F(RobotSessionRules, ClientIdHasNoTopicLevels) {
  const SessionNames names(TopicScheme("lab/slam", "pi1"));
  EXPECT_EQ(names.client_id("NRF_5"), "lab-slam-robot-NRF_5");
  EXPECT_EQ(names.mailbox_topic("NRF_5"), "lab/slam/fleet/robots/NRF_5/waiting");
  EXPECT_EQ(names.command_filter("NRF_5"), "lab/slam/server/NRF_5/#");
}

// --- Rule 1: attach on evidence only -------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule1_OpensASessionWhenTheRobotIsHeard) {
  sessions.on_heard("r1", now);
  const auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_EQ(opened[0].robot, "r1");
  EXPECT_FALSE(opened[0].is_clean);
  sessions.on_heard("r1", now);
  EXPECT_TRUE(drain<OpenSession>().empty()) << "one CONNECT at a time";
}

TEST_F(RobotSessionRulesUp, Rule1_ALostSessionWaitsUntilTheRobotIsHeardAgain) {
  attach();
  sessions.on_detached("r1", now);
  const auto lost = drain<SessionLost>();
  ASSERT_EQ(lost.size(), 1U);
  EXPECT_EQ(lost[0].why, LossReason::taken);
  pass(seconds{100});
  EXPECT_TRUE(drain<OpenSession>().empty());
  sessions.on_heard("r1", now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule1_ReopensAConnectionThatTheGatewayEndedAndDoesNotContestIt) {
  attach();
  auto wait = RobotSession::first_retry;
  for (int loss = 0; loss < 8; ++loss) {
    sessions.on_detached("r1", now, LossReason::broken);
    sessions.on_heard("r1", now);
    while (auto action = sessions.next_action()) {
      EXPECT_FALSE(std::holds_alternative<SessionContested>(*action));
      EXPECT_FALSE(std::holds_alternative<OpenSession>(*action)) << "it would fail again at once";
    }
    pass(wait);
    EXPECT_EQ(drain<OpenSession>().size(), 1U);
    wait = std::min(2 * wait, RobotSession::longest_retry);
    sessions.on_attached("r1", /*is_present=*/true, now);
  }
  pass(RobotSession::quick_loss);
  sessions.on_detached("r1", now, LossReason::broken);
  pass(RobotSession::first_retry);
  EXPECT_EQ(drain<OpenSession>().size(), 1U) << "it does not wait for the robot";
  is_served_elsewhere = true;
  sessions.on_attached("r1", /*is_present=*/true, now);
  sessions.on_detached("r1", now, LossReason::broken);
  pass(RobotSession::first_retry);
  EXPECT_TRUE(drain<OpenSession>().empty()) << "another gateway has the robot";
}

TEST_F(RobotSessionRules, Rule1_OpensNothingBeforeTheBrokerIsUp) {
  sessions.on_heard("r1", now);
  EXPECT_TRUE(drain<OpenSession>().empty());
  sessions.on_broker_up(true, false, now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, OpensABoundedNumberOfSessionsAtOnce) {
  for (int i = 0; i < 50; ++i) sessions.on_heard("r" + std::to_string(i), now);
  EXPECT_EQ(drain<OpenSession>().size(), RobotSessions::max_opening);
  sessions.on_attached("r0", false, now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_heard("one too many", now);
  EXPECT_EQ(drain<Notice>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, RetriesARefusedConnectAfterGrowingPauses) {
  sessions.on_heard("r1", now);
  for (const seconds wait : {seconds{1}, seconds{2}, seconds{4}}) {
    forget_actions();
    sessions.on_attach_failed("r1", now);
    pass(wait - milliseconds{1});
    EXPECT_TRUE(drain<OpenSession>().empty());
    pass(milliseconds{1});
    EXPECT_EQ(drain<OpenSession>().size(), 1U);
  }
}

/// A robot that another gateway shows. It was heard here, two CONNECTs failed, now it is silent.
class RobotThatMayHaveLeft : public RobotSessionRulesUp {
 protected:
  RobotThatMayHaveLeft() {
    is_served_elsewhere = true;
    sessions.on_heard("r1", now);
    sessions.on_attach_failed("r1", now);
    pass(RobotSession::first_retry);
    now.mono += RobotSession::silence;
    sessions.on_attach_failed("r1", now);
    forget_actions();
  }
};

/// Otherwise three gateways around a roaming robot end each other's CONNECTs.
TEST_F(RobotThatMayHaveLeft, IsRetriedAfterTheLongestPause) {
  pass(RobotSession::longest_retry - milliseconds{1});
  EXPECT_TRUE(drain<OpenSession>().empty());
  pass(milliseconds{1});
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, ConnectsAtOnceForARobotThatComesBack) {
  is_served_elsewhere = true;
  sessions.on_heard("r1", now);
  for (int i = 0; i < 4; ++i) {
    sessions.on_attach_failed("r1", now);
    for (int passed = 0; passed < 1 << i; ++passed) {
      pass(seconds{1});
      sessions.on_heard("r1", now);
    }
  }
  sessions.on_attach_failed("r1", now);
  forget_actions();
  pass(RobotSession::silence);
  sessions.on_heard("r1", now);
  EXPECT_TRUE(drain<OpenSession>().empty()) << "it was here all the time";
  now.mono += RobotSession::silence + milliseconds{1};
  sessions.on_heard("r1", now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

/// Counts the CONNECTs for a robot that is heard each 4 s, within ten minutes.
TEST_F(RobotSessionRulesUp, RetriesNoMoreOftenForARobotThatIsSilentBetweenMessages) {
  for (const bool is_refused : {false, true}) {
    is_served_elsewhere = is_refused;
    std::size_t connects = 0;
    for (int passed = 0; passed < 600; ++passed) {
      if (passed % 4 == 0) sessions.on_heard("r1", now);
      if (!drain<OpenSession>().empty()) {
        ++connects;
        sessions.on_attach_failed("r1", now, is_refused);
      }
      pass(seconds{1});
    }
    EXPECT_LE(connects, 600 / RobotSession::longest_retry.count() + 5);
    sessions.forget("r1");
    sessions.on_attach_failed("r1", now);
    forget_actions();
  }
}

TEST_F(RobotThatMayHaveLeft, IsLeftToTheGatewayThatShowsItNow) {
  sessions.on_shown_elsewhere("r1", now);
  pass(2 * RobotSession::longest_retry);
  EXPECT_TRUE(drain<OpenSession>().empty());
  sessions.on_heard("r1", now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

TEST_F(RobotThatMayHaveLeft, Rule7_DoesNotWaitWhenItsGatewayHasDied) {
  is_served_elsewhere = false;
  sessions.keep("r1", now.mono, seconds{5}, now);
  pass(seconds{5});
  pass(4 * RobotSession::first_retry);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

/// The failed CONNECT may have ended the other gateway's session, so commands may wait since then.
TEST_F(RobotThatMayHaveLeft, Rule7_IsRetriedBeforeACommandCanBecomeStale) {
  pass(RobotSession::stale_after);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

// --- Rule 5: flapping ----------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule5_GatewaysThatTakeASessionFromEachOtherWaitLongerEachTime) {
  for (unsigned i = 0; i <= RobotSession::free_losses; ++i) {
    attach(true);
    sessions.on_detached("r1", now);
  }
  forget_actions();
  sessions.on_heard("r1", now);
  EXPECT_TRUE(drain<OpenSession>().empty());
  pass(RobotSession::first_flap_wait);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_attached("r1", true, now);
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  forget_actions();
  pass(RobotSession::first_flap_wait);
  EXPECT_TRUE(drain<OpenSession>().empty()) << "twice as long";
  pass(RobotSession::first_flap_wait);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

class ContestedSession : public RobotSessionRulesUp {
 protected:
  /// The session is taken from this gateway, `times` in a row.
  void lose(unsigned times) {
    for (unsigned i = 0; i < times; ++i) {
      attach(true);
      sessions.on_detached("r1", now);
    }
  }
  struct Reports {
    std::vector<bool> contested;
    std::vector<std::string> notices;
  };
  Reports reports() {
    Reports all;
    while (auto action = sessions.next_action()) {
      if (const auto* it = std::get_if<SessionContested>(&*action))
        all.contested.push_back(it->is_contested);
      if (const auto* it = std::get_if<Notice>(&*action)) all.notices.push_back(it->text);
    }
    return all;
  }
};

TEST_F(ContestedSession, Rule5_IsReportedOnceAndEndsAfterAQuietMinute) {
  lose(2);
  EXPECT_TRUE(reports().contested.empty()) << "the robot may have gone";
  for (int i = 0; i < 3; ++i) sessions.on_heard("r1", now);
  Reports first = reports();
  EXPECT_EQ(first.contested, std::vector{true});
  ASSERT_EQ(first.notices.size(), 1U);
  EXPECT_NE(first.notices[0].find("a second robot or a foreign client with this name?"),
            std::string::npos);
  EXPECT_TRUE(sessions.is_contested("r1"));
  sessions.on_attached("r1", true, now);
  pass(RobotSession::quiet_minute - seconds{1});
  EXPECT_TRUE(sessions.is_contested("r1"));
  forget_actions();
  pass(seconds{1});
  EXPECT_FALSE(sessions.is_contested("r1"));
  Reports last = reports();
  EXPECT_EQ(last.contested, std::vector{false});
  EXPECT_EQ(last.notices.size(), 1U);
}

TEST_F(ContestedSession, Rule5_ForeignClientThatConnectsTwiceAMinuteIsReported) {
  for (int i = 0; i < 2; ++i) {
    attach(true);
    pass(seconds{25});
    sessions.on_detached("r1", now);
  }
  sessions.on_heard("r1", now);
  EXPECT_EQ(reports().contested, std::vector{true});
}

/// Otherwise a shared mesh would leave the robot unacknowledged for the whole outage.
TEST_F(ContestedSession, Rule11_LossJustBeforeTheBrokersIsReportedAsTheBrokers) {
  attach(true);
  sessions.on_detached("r1", now);
  EXPECT_EQ(drain<SessionLost>().at(0).why, LossReason::taken);
  sessions.on_broker_down(now);
  const auto lost = drain<SessionLost>();
  ASSERT_EQ(lost.size(), 1U);
  EXPECT_EQ(lost[0].why, LossReason::broker_gone);
}

TEST_F(ContestedSession, Rule11_BrokerThatRestartsRepeatedlyContestsNoSession) {
  for (int i = 0; i < 3; ++i) {
    attach(true);
    sessions.on_detached("r1", now);  // a moment before the gateway's own connection
    sessions.on_broker_down(now);
    pass(seconds{2});
    sessions.on_broker_up(true, false, now);
  }
  EXPECT_FALSE(sessions.is_contested("r1"));
  forget_actions();
  pass(RobotSessions::unheard_delay);
  EXPECT_EQ(drain<OpenSession>().size(), 1U)
      << "the session reopens, whether the robot is heard or not";
}

TEST_F(ContestedSession, Rule5_ARobotThatRoamsIsNotContested) {
  for (int i = 0; i < 4; ++i) {
    attach(true);
    pass(seconds{12});
    sessions.on_detached("r1", now);
    is_served_elsewhere = true;
    pass(seconds{1});
    sessions.on_heard("r1", now);
    EXPECT_FALSE(sessions.is_contested("r1")) << "move " << i;
  }
}

TEST_F(ContestedSession, RefusesAFilterThatBreaksTheConnectionTwiceAndBlamesNoClient) {
  subscribe("ntnu-slam/robot/+/update");
  for (int i = 0; i < 2; ++i) {
    sessions.on_heard("r1", now);
    sessions.on_attached("r1", true, now);
    sessions.on_detached("r1", now);
  }
  const auto answers = drain<FilterAnswered>();
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_FALSE(answers[0].is_granted);
  sessions.on_heard("r1", now);
  EXPECT_FALSE(sessions.is_contested("r1"));
}

TEST_F(ContestedSession, Rule5_LossesOlderThanAMinuteDoNotCount) {
  lose(2);
  pass(RobotSession::quiet_minute);
  sessions.on_heard("r1", now);
  EXPECT_TRUE(reports().contested.empty());
}

TEST_F(RobotSessionRulesUp, KeepsNoTimerForEachMessageWhileASessionMayNotOpen) {
  for (unsigned i = 0; i <= RobotSession::free_losses; ++i) {
    attach(true);
    sessions.on_detached("r1", now);
  }
  for (int i = 0; i < 1000; ++i) sessions.on_heard("r1", now);
  forget_actions();
  pass(RobotSession::first_flap_wait);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  EXPECT_GT(sessions.deadline(), now.mono + RobotSession::first_flap_wait) << "it is contested";
}

TEST_F(RobotSessionRulesUp, AForgottenRobotLeavesNoTimer) {
  for (int i = 0; i < 3; ++i) {
    sessions.keep("r1", {}, seconds{5}, now);
    sessions.forget("r1");
  }
  EXPECT_EQ(sessions.deadline(), std::nullopt);
}

/// A client that only sent CONNECT has a presence, but never had a session. A flood of such clients
/// must not fill the broker with connections after a restart.
TEST_F(RobotSessionRulesUp, EndsAKeptSessionThatTheBrokerDidNotHave) {
  sessions.keep("r1", {}, {}, now);
  pass({});
  forget_actions();
  sessions.on_attached("r1", false, now);
  const auto closed = drain<CloseSession>();
  ASSERT_EQ(closed.size(), 1U);
  EXPECT_TRUE(closed[0].is_forgotten);
  EXPECT_EQ(sessions.held(), 0U);

  sessions.keep("r1", {}, {}, now);
  pass({});
  sessions.on_attached("r1", true, now);
  EXPECT_TRUE(drain<CloseSession>().empty()) << "commands may wait in it";
  EXPECT_EQ(sessions.held(), 1U);
}

TEST_F(RobotSessionRulesUp, HoldsAKeptSessionOfARobotWithSubscriptions) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/cmd", Qos::at_least_once, true, now);
  sessions.keep("r1", {}, {}, now);
  pass({});
  sessions.on_attached("r1", false, now);
  EXPECT_TRUE(drain<CloseSession>().empty());
  EXPECT_EQ(sessions.held(), 1U);
}

// --- Rule 11: the broker is away -----------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule11_OpensSessionsOfHeardRobotsFirstWhenTheBrokerIsBack) {
  attach();
  sessions.on_heard("r2", now);
  sessions.on_attached("r2", false, now);
  forget_actions();
  sessions.on_broker_down(now);
  EXPECT_EQ(drain<SessionLost>().size(), 2U);
  EXPECT_EQ(sessions.held(), 0U);
  pass(seconds{8});
  sessions.on_heard("r2", now);
  sessions.on_broker_up(true, false, now);
  auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_EQ(opened[0].robot, "r2");
  pass(RobotSessions::unheard_delay);
  opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_EQ(opened[0].robot, "r1");
}

TEST_F(RobotSessionRulesUp, Rule11_RetriesAConnectThatFailedWithTheBrokerAtOnceWhenItIsBack) {
  for (int i = 0; i < 5; ++i) {
    sessions.on_heard("r1", now);
    ASSERT_EQ(drain<OpenSession>().size(), 1U);
    sessions.on_broker_down(now);
    sessions.on_broker_up(true, false, now);
    ASSERT_EQ(drain<OpenSession>().size(), 1U);
    sessions.on_attach_failed("r1", now);
    sessions.on_broker_down(now);
    sessions.on_broker_up(true, false, now);
  }
}

TEST_F(RobotSessionRulesUp, Rule11_AttachesRobotsLaterWhoseConnectWaitedWhenTheBrokerWentDown) {
  for (int i = 0; i < 40; ++i) sessions.on_heard("r" + std::to_string(i), now);
  sessions.on_broker_down(now);
  forget_actions();
  sessions.on_broker_up(true, false, now);
  EXPECT_EQ(drain<OpenSession>().size(), RobotSessions::max_opening);
  for (int i = 0; i < 40; ++i) sessions.on_attached("r" + std::to_string(i), false, now);
  for (int i = 0; i < 40; ++i) sessions.on_attached("r" + std::to_string(i), false, now);
  EXPECT_EQ(sessions.held(), 40U);
}

TEST_F(RobotSessionRulesUp, SubscribesEverythingAtAnotherBrokerAndRefusesItsOldCommands) {
  attach();
  subscribed_id("ntnu-slam/robot/+/update");
  sessions.on_broker_down(now);
  sessions.on_broker_up(true, /*is_other=*/true, now);
  sessions.on_heard("r1", now);
  forget_actions();
  sessions.on_attached("r1", /*is_present=*/true, now);
  EXPECT_EQ(subscribed().back(), "ntnu-slam/robot/+/update");
  arrives(command("of last week"));
  EXPECT_TRUE(fenced().empty());
}

TEST_F(RobotSessionRulesUp, Rule2_ProvesThatItHoldsASessionByAFence) {
  sessions.prove("r1");
  attach();
  forget_actions();
  sessions.prove("r1");
  const auto fences = drain<AskFence>();
  ASSERT_EQ(fences.size(), 1U);
  sessions.on_detached("r1", now);
  attach();
  sessions.on_fence("r1", fences[0].number, now);
  EXPECT_TRUE(drain<SessionProven>().empty()) << "the session was lost meanwhile";
  sessions.prove("r1");
  sessions.on_fence("r1", drain<AskFence>().at(0).number, now);
  EXPECT_EQ(drain<SessionProven>().size(), 1U);
}

// --- Forgetting ----------------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, AForgottenRobotLeavesNothingAtTheBroker) {
  attach();
  sessions.forget("r1");
  const auto closed = drain<CloseSession>();
  ASSERT_EQ(closed.size(), 1U);
  EXPECT_TRUE(closed[0].is_forgotten);
  EXPECT_EQ(sessions.held(), 0U);
}

TEST_F(RobotSessionRulesUp, ForgettingARobotEndsItsRefusal) {
  sessions.on_heard("r1", now);
  sessions.on_attach_failed("r1", now, /*is_refused=*/true);
  EXPECT_TRUE(sessions.is_refused("r1"));
  sessions.forget("r1");
  sessions.on_attach_failed("r1", now, /*is_refused=*/true);
  EXPECT_FALSE(sessions.is_refused("r1"));
}

TEST_F(RobotSessionRulesUp, RefusalLastsUntilTheSessionIsHeldOrTheBrokerIsDown) {
  for (const bool is_lost : {false, true}) {
    sessions.on_heard("r1", now);
    sessions.on_attach_failed("r1", now, /*is_refused=*/true);
    pass(RobotSession::longest_retry);
    sessions.on_attach_failed("r1", now);
    EXPECT_TRUE(sessions.is_refused("r1"));
    pass(RobotSession::longest_retry);
    if (is_lost) {
      sessions.on_broker_down(now);
    } else {
      sessions.on_attached("r1", false, now);
      sessions.on_detached("r1", now);
    }
    EXPECT_FALSE(sessions.is_refused("r1"));
  }
}

/// Each command for a robot that may be at another gateway calls keep(): many may come.
TEST_F(RobotSessionRulesUp, KeepingARobotAgainDoesNotPostponeItsConnect) {
  sessions.keep("r1", {}, std::chrono::seconds(5), now);
  pass(std::chrono::seconds(3));
  sessions.keep("r1", {}, std::chrono::seconds(5), now);
  pass(std::chrono::seconds(1));
  EXPECT_TRUE(drain<OpenSession>().empty());
  pass(std::chrono::seconds(1));
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
}

/// All boards of a shared mesh hear the robot, so hearing it does not show which gateway serves it.
TEST_F(RobotSessionRulesUp, ReportsASessionAsJustTakenUntilTheOtherGatewayCanShowTheRobot) {
  EXPECT_FALSE(sessions.was_just_taken("r1", now.mono));
  attach();
  EXPECT_FALSE(sessions.was_just_taken("r1", now.mono));
  sessions.on_detached("r1", now);
  EXPECT_TRUE(sessions.was_just_taken("r1", now.mono));
  pass(RobotSessions::showing);
  EXPECT_FALSE(sessions.was_just_taken("r1", now.mono));
  attach();
  sessions.on_broker_down(now);
  EXPECT_FALSE(sessions.was_just_taken("r1", now.mono)) << "no other client has taken it";
}

class ForgottenRobots : public RobotSessionRules {
 protected:
  void expect_a_clean_open_and_close() {
    const auto opened = drain<OpenSession>();
    ASSERT_EQ(opened.size(), 1U);
    EXPECT_TRUE(opened[0].is_clean);
    sessions.on_attached("r1", false, now);
    EXPECT_EQ(drain<CloseSession>().size(), 1U);
    EXPECT_EQ(sessions.held(), 0U);
  }
};

TEST_F(ForgottenRobots, OnMqtt311AreForgottenByACleanConnect) {
  sessions.on_broker_up(/*is_v5=*/false, false, now);
  attach();
  sessions.forget("r1");
  expect_a_clean_open_and_close();
}

TEST_F(ForgottenRobots, AreForgottenAtTheBrokerWithoutAHeldSession) {
  sessions.on_broker_up(/*is_v5=*/true, false, now);
  sessions.forget("r1");
  expect_a_clean_open_and_close();
  is_served_elsewhere = true;
  sessions.forget("r1");
  EXPECT_TRUE(drain<OpenSession>().empty()) << "it is another gateway's";
}

TEST_F(ForgottenRobots, WaitForTheBroker) {
  sessions.forget("r1");
  EXPECT_TRUE(drain<OpenSession>().empty());
  sessions.on_broker_up(/*is_v5=*/false, false, now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_broker_down(now);
  sessions.on_broker_up(/*is_v5=*/false, false, now);
  expect_a_clean_open_and_close();
}

TEST_F(ForgottenRobots, AreBoundedAndPaced) {
  for (std::size_t i = 0; i < 2 * RobotSessions::max_forgetting; ++i)
    sessions.forget("r" + std::to_string(i));
  sessions.on_broker_up(/*is_v5=*/true, false, now);
  std::size_t opened = 0;
  for (auto batch = drain<OpenSession>(); !batch.empty(); batch = drain<OpenSession>()) {
    EXPECT_LE(batch.size(), RobotSessions::max_opening);
    opened += batch.size();
    for (std::size_t i = 0; i < batch.size(); ++i)
      if (i % 2 == 0)
        sessions.on_attached(batch[i].robot, false, now);
      else
        sessions.on_attach_failed(batch[i].robot, now);
  }
  EXPECT_EQ(opened, RobotSessions::max_forgetting);
  sessions.on_heard("r1", now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U) << "failed attempts free their places";
}

TEST_F(ForgottenRobots, ThatAreHeardAgainGetACleanSession) {
  sessions.on_broker_up(/*is_v5=*/true, false, now);
  sessions.forget("r1");
  forget_actions();
  sessions.on_heard("r1", now);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(sessions.held(), 0U) << "it refuses the waiting messages first";
  pass(RobotSession::marker_patience);
  const auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_TRUE(opened[0].is_clean);
}

TEST_F(ForgottenRobots, ThatAreHeardAgainGetACleanSessionAfterALossWhileSorting) {
  sessions.on_broker_up(/*is_v5=*/true, false, now);
  sessions.forget("r1");
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  arrives(command("old"));
  sessions.on_detached("r1", now);  // no fence was answered
  forget_actions();
  pass(RobotSession::longest_retry);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_attached("r1", true, now);
  pass(RobotSession::marker_patience);
  const auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U) << "it waits for the fence of a lost connection";
  EXPECT_TRUE(opened[0].is_clean);
}

// --- What another gateway leaves behind ----------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule7_SendsAnotherMarkerAfterAConnectionBrokeWhileSorting) {
  now.mono += seconds{60};
  attach(true);
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(drain<SendMarker>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule13_RestoresTheRobotsFilterForAllCommandsWithItsSession) {
  const std::string everything = "ntnu-slam/server/r1/#";
  attach();
  subscribed_id(everything);
  sessions.on_detached("r1", now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  const auto filters = subscribed();
  EXPECT_EQ(std::ranges::count(filters, everything), 1)
      << "another gateway may have replaced it with its own";
}

TEST_F(RobotSessionRulesUp, GivesUpARobotThatMovedWhileTheBrokerWasAway) {
  attach(true);
  sessions.on_broker_down(now);
  is_served_elsewhere = true;
  sessions.on_broker_up(/*is_v5=*/true, /*is_other=*/false, now);
  forget_actions();
  pass(RobotSessions::unheard_delay);
  const auto lost = drain<SessionLost>();
  ASSERT_EQ(lost.size(), 1U);
  EXPECT_EQ(lost[0].why, LossReason::taken);
}
}  // namespace
}  // namespace slamgw::sessions
