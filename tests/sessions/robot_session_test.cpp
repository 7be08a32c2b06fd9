// SPDX-License-Identifier: Apache-2.0
// One gateway's sessions, step by step: the test plays the broker.
#include <gtest/gtest.h>

#include <vector>

#include "daemon/sessions/robot_sessions.hpp"

namespace slamgw::sessions {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class RobotSessionRules : public testing::Test {
 protected:
  template <class Action>
  std::vector<Action> drain() {
    std::vector<Action> wanted;
    while (auto action = sessions.next_action())
      if (auto* it = std::get_if<Action>(&*action)) wanted.push_back(std::move(*it));
    return wanted;
  }
  void forget_actions() {
    while (sessions.next_action()) {
    }
  }
  void attach(bool is_present = false) {
    sessions.on_heard("r1", now);
    sessions.on_attached("r1", is_present, now);
    forget_actions();
  }
  void pass(Duration time) {
    now.mono += time;
    sessions.on_deadline(now);
  }
  static BrokerMessage command(const std::string& payload, Qos qos = Qos::at_least_once) {
    return {"ntnu-slam/server/r1/run", to_bytes(payload), qos, false};
  }
  void arrives(BrokerMessage message, std::vector<std::uint32_t> ids = {}) {
    sessions.on_message("r1", std::move(message), ids, now);
  }

  Now now{TimePoint{std::chrono::hours{1}}, WallTime{}};
  bool is_served_elsewhere = false;
  RobotSessions sessions{SessionNames(TopicScheme("ntnu-slam", "pi1")),
                         [this](const std::string&) { return is_served_elsewhere; }, 50};
};

class RobotSessionRulesUp : public RobotSessionRules {
 protected:
  RobotSessionRulesUp() { sessions.on_broker_up(/*is_v5=*/true, /*is_other=*/false, now); }
};

TEST_F(RobotSessionRules, NamesNeedNoLevelsInTheClientId) {
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

TEST_F(RobotSessionRules, Rule1_NothingIsOpenedBeforeTheBrokerIsThere) {
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

TEST_F(RobotSessionRulesUp, ARefusedConnectIsTriedAgainEverLater) {
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

// --- Rule 2: the fence ---------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule2_ACommandIsTakenWhenTheFenceHasComeBack) {
  attach();
  arrives(command("1"));
  const auto fences = drain<AskFence>();
  ASSERT_EQ(fences.size(), 1U);
  now.mono += milliseconds{3};
  sessions.on_fence("r1", fences[0].number, now);
  const auto taken = drain<TakeMessage>();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_EQ(as_text(taken[0].message.payload), "1");
  EXPECT_EQ(taken[0].message.waited, Waited{3}) << "it counts of the 30 s";
}

TEST_F(RobotSessionRulesUp, Rule2_WithoutAnAnswerTheCommandIsNotOurs) {
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

TEST_F(RobotSessionRulesUp, MessagesWithoutAFenceAreBounded) {
  attach();
  for (std::size_t i = 0; i < 2 * RobotSession::max_unfenced; ++i) arrives(command("1"));
  EXPECT_EQ(drain<AskFence>().size(), RobotSession::max_unfenced);
}

// --- Rule 5: flapping ----------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule5_TwoThatTakeTheSessionFromEachOtherWaitEverLonger) {
  for (unsigned i = 0; i <= RobotSession::free_losses; ++i) {
    attach(true);
    sessions.on_detached("r1", now);
  }
  EXPECT_EQ(drain<Notice>().size(), 1U);
  sessions.on_heard("r1", now);
  EXPECT_TRUE(drain<OpenSession>().empty());
  EXPECT_TRUE(sessions.is_contested("r1"));
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

TEST_F(RobotSessionRulesUp, Rule5_AQuietMinuteEndsIt) {
  for (int i = 0; i < 3; ++i) {
    attach(true);
    sessions.on_detached("r1", now);
  }
  attach(true);
  EXPECT_TRUE(sessions.is_contested("r1"));
  pass(RobotSession::longest_flap_wait);
  sessions.on_heard("r1", now);
  EXPECT_FALSE(sessions.is_contested("r1"));
}

TEST_F(RobotSessionRulesUp, MessagesWhileASessionMayNotOpenLeaveOneTimerEach) {
  for (unsigned i = 0; i <= RobotSession::free_losses; ++i) {
    attach(true);
    sessions.on_detached("r1", now);
  }
  for (int i = 0; i < 1000; ++i) sessions.on_heard("r1", now);
  forget_actions();
  pass(RobotSession::first_flap_wait);
  EXPECT_EQ(drain<OpenSession>().size(), 1U);
  EXPECT_EQ(sessions.deadline(), std::nullopt);
}

// --- Rule 7: what nobody held --------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule7_WhatWaitedWhileNobodyHeldTheSessionIsRefused) {
  sessions.keep("r1", now.mono - seconds{26}, seconds{5}, now);
  pass(seconds{5});
  ASSERT_EQ(drain<OpenSession>().size(), 1U);
  sessions.on_attached("r1", true, now);
  const auto markers = drain<SendMarker>();
  ASSERT_EQ(markers.size(), 1U);
  arrives(command("old"));
  sessions.on_fence("r1", 1, now);
  EXPECT_TRUE(drain<TakeMessage>().empty()) << "it is not known yet whether it is old";
  arrives(
      {"ntnu-slam/fleet/robots/r1/waiting", to_bytes(markers[0].text), Qos::at_least_once, false});
  const auto stale = drain<RefuseStale>();
  ASSERT_EQ(stale.size(), 1U);
  EXPECT_EQ(as_text(stale[0].message.payload), "old");
  arrives(command("new"));
  sessions.on_fence("r1", 2, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_WithoutAMarkerAllIsOldAfterItsTime) {
  sessions.keep("r1", now.mono - seconds{60}, {}, now);
  pass({});
  sessions.on_attached("r1", true, now);
  arrives(command("old"));
  sessions.on_fence("r1", 1, now);
  forget_actions();
  pass(RobotSession::marker_patience);
  EXPECT_EQ(drain<RefuseStale>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_WhatWaitedForAShortTimeIsObeyed) {
  sessions.keep("r1", now.mono - seconds{3}, seconds{5}, now);
  pass(seconds{5});
  sessions.on_attached("r1", true, now);
  EXPECT_TRUE(drain<SendMarker>().empty());
  arrives(command("1"));
  sessions.on_fence("r1", 1, now);
  EXPECT_EQ(drain<TakeMessage>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, Rule7_NobodyAnswersForARobotThatALivingGatewayShows) {
  sessions.keep("r1", now.mono, seconds{5}, now);
  is_served_elsewhere = true;
  pass(seconds{5});
  EXPECT_TRUE(drain<OpenSession>().empty());
}

// --- Rule 11: the broker is away -----------------------------------------------------------------

TEST_F(RobotSessionRulesUp, Rule11_RobotsThatWereHeardComeFirstWhenTheBrokerIsBack) {
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

// --- Subscriptions -------------------------------------------------------------------------------

TEST_F(RobotSessionRulesUp, SubscribesWhatTheRobotAskedForWhenTheSessionIsNew) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, false, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", false, now);
  std::vector<std::string> filters;
  for (const auto& each : drain<SubscribeSession>()) filters.push_back(each.filter);
  EXPECT_EQ(filters, (std::vector<std::string>{"ntnu-slam/fleet/robots/r1/waiting",
                                               "ntnu-slam/server/r1/+"}));
  sessions.on_subscribed("r1", "ntnu-slam/server/r1/+", true);
  const auto answers = drain<FilterAnswered>();
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_TRUE(answers[0].is_granted);
}

TEST_F(RobotSessionRulesUp, LeavesToTheBrokerWhatItsSessionHas) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, true, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(drain<SubscribeSession>().size(), 1U) << "the mailbox only";
}

TEST_F(RobotSessionRulesUp, SubscribesAgainWhenTheBrokerHasForgotten) {
  sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, true, now);
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", false, now);
  EXPECT_EQ(drain<SubscribeSession>().size(), 2U);
}

TEST_F(RobotSessionRulesUp, UnsubscribesLaterWhatWasGivenUpWhileTheSessionWasAway) {
  sessions.subscribe("r1", "ntnu-slam/robot/+/update", Qos::at_least_once, true, now);
  attach(true);
  sessions.on_detached("r1", now);
  sessions.unsubscribe("r1", "ntnu-slam/robot/+/update");
  sessions.on_heard("r1", now);
  sessions.on_attached("r1", true, now);
  EXPECT_EQ(drain<UnsubscribeSession>().size(), 1U);
}

TEST_F(RobotSessionRulesUp, ACleanRobotBeginsAnew) {
  sessions.subscribe("r1", "ntnu-slam/robot/+/update", Qos::at_least_once, false, now);
  sessions.on_heard("r1", now);
  forget_actions();
  sessions.on_detached("r1", now);
  sessions.begin_clean("r1");
  pass(seconds{1});
  const auto opened = drain<OpenSession>();
  ASSERT_EQ(opened.size(), 1U);
  EXPECT_TRUE(opened[0].is_clean);
  sessions.on_attached("r1", false, now);
  EXPECT_EQ(drain<SubscribeSession>().size(), 1U) << "the mailbox only";
}

// --- Rule 13: what the robot has not subscribed to -----------------------------------------------

class RobotSessionHears : public RobotSessionRulesUp {
 protected:
  RobotSessionHears() {
    sessions.on_heard("r1", now);
    sessions.hear_commands("r1", /*wants_retained=*/false);
    sessions.subscribe("r1", "ntnu-slam/server/r1/cmd", Qos::at_least_once, false, now);
    sessions.subscribe("r1", "ntnu-slam/server/r1/+", Qos::at_least_once, false, now);
    sessions.unsubscribe("r1", "ntnu-slam/server/r1/+");
    sessions.on_attached("r1", false, now);
    sessions.on_subscribed("r1", "ntnu-slam/server/r1/cmd", true);
    forget_actions();
  }
  BrokerMessage cmd() { return {"ntnu-slam/server/r1/cmd", {}, Qos::at_least_once, false}; }
};

TEST_F(RobotSessionHears, Rule13_WhatTheGatewaysFilterAloneBroughtIsUnasked) {
  arrives(command("1"), {RobotSession::command_id});
  sessions.on_fence("r1", 1, now);
  const auto taken = drain<TakeMessage>();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_TRUE(taken[0].is_unasked);
}

TEST_F(RobotSessionHears, Rule13_OfTwoCopiesTheRobotsOwnIsTaken) {
  arrives(cmd(), {RobotSession::command_id});
  arrives(cmd(), {RobotSession::first_filter_id});
  sessions.on_fence("r1", 2, now);
  const auto taken = drain<TakeMessage>();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_FALSE(taken[0].is_unasked);
}

TEST_F(RobotSessionHears, Rule13_OneMessageForBothFiltersIsTaken) {
  arrives(cmd(), {RobotSession::command_id, RobotSession::first_filter_id});
  sessions.on_fence("r1", 1, now);
  const auto taken = drain<TakeMessage>();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_FALSE(taken[0].is_unasked);
}

TEST_F(RobotSessionHears, AForgottenRobotLeavesNothingAtTheBroker) {
  sessions.forget("r1");
  const auto closed = drain<CloseSession>();
  ASSERT_EQ(closed.size(), 1U);
  EXPECT_TRUE(closed[0].is_forgotten);
  EXPECT_EQ(sessions.held(), 0U);
}

}  // namespace
}  // namespace slamgw::sessions
