// SPDX-License-Identifier: Apache-2.0
// When a gateway that has connected takes part, and what it does with the robots that it has.
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

/// A member that was cut off for 10 s. Its own beats come back at once; the rest is up to the test.
class Reconnected : public LoopedBack {
 protected:
  void SetUp() override {
    LoopedBack::SetUp();
    reconnect();
  }
  void reconnect() {
    ownership.on_broker_link(false, at(now));
    now += 10s;
    ownership.on_broker_link(true, at(now));
  }
  void broker_answers(const std::string& filter,
                      SubscribeAnswer answer = SubscribeAnswer::granted) {
    ownership.on_subscribe_result(filter, answer, at(now));
  }
  bool has_lease_after(Duration span) {
    pass(span);
    return ownership.is_leased(at(now).mono);
  }
};

/// NATS takes half a second for each subscription, and the one to beats comes first. A gateway that
/// acted by then would miss releases and outcomes.
TEST_F(Reconnected, HasNoLeaseBeforeTheBrokerHasAnsweredAllSubscriptions) {
  broker_answers("p/fleet/all/+");
  broker_answers("p/gateway/+/commands/+");
  broker_answers("p/server/+/+");
  EXPECT_FALSE(has_lease_after(5s));
  EXPECT_EQ(ownership.phase(), Ownership::Phase::joining);
  broker_answers("p/fleet/to/gw-0/+");
  EXPECT_TRUE(has_lease_after(600ms));
  EXPECT_EQ(ownership.phase(), Ownership::Phase::joining) << "it listens for a second";
  EXPECT_TRUE(has_lease_after(1s));
  EXPECT_EQ(ownership.phase(), Ownership::Phase::member);
}

/// What others have claimed meanwhile is lost, and who has may be cut off in its turn.
TEST_F(Reconnected, ListensForASecondAgainWhenItWasCutOffForAMomentWhileItJoined) {
  others_answered(now);
  pass(900ms);
  ASSERT_EQ(ownership.phase(), Ownership::Phase::joining);
  const Life before = ownership.life();
  ownership.on_broker_link(false, at(now));
  now += 500ms;
  ownership.on_broker_link(true, at(now));
  others_answered(now);
  pass(900ms);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::joining);
  pass(600ms);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::member);
  EXPECT_EQ(ownership.life(), before);
}

TEST_F(Reconnected, TakesPartWithoutASubscriptionThatTheBrokerRefuses) {
  broker_answers("p/fleet/all/+");
  broker_answers("p/fleet/to/gw-0/+");
  broker_answers("p/gateway/+/commands/+", SubscribeAnswer::refused);
  broker_answers("p/server/+/+", SubscribeAnswer::closes_connection);
  EXPECT_TRUE(has_lease_after(600ms));
  answers = false;
  reconnect();
  pass(10ms);  // it asks for the outcomes again, and not for the commands
  broker_answers("p/fleet/all/+");
  broker_answers("p/fleet/to/gw-0/+");
  EXPECT_FALSE(has_lease_after(600ms));
  broker_answers("p/gateway/+/commands/+");
  EXPECT_TRUE(has_lease_after(600ms));
}

/// Operators, and judges of live runs, see how often a gateway has served nobody for a while.
TEST_F(Reconnected, CountsEachLapseOfItsLeaseOnce) {
  EXPECT_EQ(ownership.lease_lapses(), 1U) << "it was cut off";
  for (const char* filter :
       {"p/fleet/all/+", "p/fleet/to/gw-0/+", "p/gateway/+/commands/+", "p/server/+/+"})
    broker_answers(filter);
  EXPECT_TRUE(has_lease_after(5s));
  EXPECT_EQ(ownership.lease_lapses(), 1U);
  is_writing_lost = true;
  EXPECT_FALSE(has_lease_after(5s));
  EXPECT_EQ(ownership.lease_lapses(), 2U) << "once, though lives begin and end";
  is_writing_lost = false;
  EXPECT_TRUE(has_lease_after(5s));
  EXPECT_EQ(ownership.lease_lapses(), 2U);
}

TEST_F(Reconnected, DoesNotWaitForEverForAnAnswer) {
  EXPECT_FALSE(has_lease_after(59s));
  EXPECT_TRUE(ownership.missing_rights(at(now).mono).empty()) << "its beats come back";
  EXPECT_TRUE(has_lease_after(2s));
}

/// While it was cut off its robot may have gone to another gateway, which announces it.
TEST_F(Reconnected, AnnouncesNoRobotBeforeItTakesPart) {
  const auto may_announce = [&](Presence presence, bool has_just_come) {
    return ownership.may_announce("r", presence, has_just_come, at(now).mono);
  };
  EXPECT_FALSE(may_announce(Presence::online, false));
  EXPECT_FALSE(may_announce(Presence::asleep, false));
  EXPECT_FALSE(may_announce(Presence::online, true)) << "it may have moved on";
  EXPECT_TRUE(may_announce(Presence::offline, false));
  others_answered(now);
  pass(500ms);
  EXPECT_FALSE(may_announce(Presence::online, true));
  pass(2s);
  ASSERT_EQ(ownership.phase(), Ownership::Phase::member);
  EXPECT_TRUE(may_announce(Presence::online, false));
  ownership.on_broker_link(false, at(now));
  EXPECT_TRUE(may_announce(Presence::online, false)) << "others wait for it";
  now += 2s;
  EXPECT_FALSE(may_announce(Presence::online, false)) << "its life is over";
}

/// The connection lasts, and nothing comes back any more: somebody has changed the broker's access
/// control list.
TEST_F(LoopedBack, SaysThatNothingComesBackAnyMoreAndServesItsRobotsAsIfItWereAlone) {
  is_writing_lost = true;
  notices.clear();
  pass(50s);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::joining) << "the broker may be slow";
  pass(20s);
  EXPECT_TRUE(ownership.is_alone());
  EXPECT_TRUE(ownership.may_act_for("r", at(now).mono));
  ASSERT_EQ(notices.size(), 1U);
  EXPECT_NE(notices[0].text.find("gives back nothing"), std::string::npos) << notices[0].text;
  EXPECT_EQ(ownership.missing_rights(at(now).mono).size(), 1U);
}

TEST_F(LoopedBack, TakesPartAgainWhenItsMessagesComeBackWithinAMinute) {
  is_writing_lost = true;
  notices.clear();
  pass(50s);
  is_writing_lost = false;
  pass(5s);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::member);
  pass(60s);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::member);
  EXPECT_TRUE(notices.empty());
}

TEST_F(LoopedBack, RemembersOnceThatOthersAreAboutUntilNoneIs) {
  EXPECT_EQ(remembered, std::vector<bool>{true});
  beat_of_gw_1(9000);
  pass(50s);
  EXPECT_EQ(remembered, std::vector<bool>{true});
  ownership.on_broker_message(
      {"p/gateway/gw-1/state", to_bytes(R"({"state":"offline"})"), Qos::at_least_once, false},
      at(now));
  pass(5min);
  EXPECT_TRUE(ownership.is_alone());
  EXPECT_EQ(remembered, (std::vector<bool>{true, false}));
}

/// A gateway that starts, and remembers that it had company. The broker has no retained states for
/// it: one of its nodes has just died.
class Remembering : public LoopedBack {
 protected:
  Remembering() : LoopedBack(true) {}
  void SetUp() override {
    local = {{"r", true}};
    ownership.on_broker_link(true, at(0s));
    states_answered(0s);
  }
};

TEST_F(Remembering, IsNotAloneOnlyBecauseNobodyIsTold) {
  command(10ms);
  pass(900ms);
  EXPECT_FALSE(ownership.is_alone());
  EXPECT_FALSE(ownership.may_announce("r", Presence::online, true, at(now).mono));
  EXPECT_EQ(carried, 0);
  beat_of_gw_1(9000);
  comes_from_gw_1(Table{{}, {}, {{"r", 7}}});
  pass(5s);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::member);
  EXPECT_FALSE(ownership.may_act_for("r", at(now).mono)) << "it is at gw-1";
  EXPECT_TRUE(remembered.empty()) << "no news";
}

/// The next connection does not wait for them again.
TEST_F(Remembering, ForgetsThemWhenItMayNotSpeakAndNobodyIsOnline) {
  is_writing_lost = true;
  pass(11s);
  EXPECT_TRUE(ownership.is_alone());
  EXPECT_EQ(remembered, std::vector<bool>{false});
}

TEST_F(Remembering, ServesItsRobotsSoonAndFallsAsleepWhenNobodyComes) {
  pass(5s);
  ownership.on_heard("r", at(now));
  pass(1s);
  EXPECT_TRUE(ownership.may_act_for("r", at(now).mono));
  pass(60s);
  EXPECT_TRUE(ownership.is_alone());
  EXPECT_EQ(remembered, std::vector<bool>{false});
}

/// A gateway that joins, while gw-1 has claimed its robots "r", "x" and "y" by now.
class Joining : public Reconnected {
 protected:
  void SetUp() override {
    Reconnected::SetUp();
    local = {{"r", true}, {"x", true}, {"y", true}};
    beat_of_gw_1(9000);
    comes_from_gw_1(Table{{}, {}, {{"r", 7}, {"x", 5}, {"y", 3}}});
    claims.clear();
  }
  void join() {
    others_answered(now);
    pass(5s);
    ASSERT_EQ(ownership.phase(), Ownership::Phase::member);
  }
};

/// It would be cut off, and say its last message again.
TEST_F(Joining, KeepsARobotThatHasComeHereSinceItsLifeBegan) {
  ownership.on_heard("x", at(now));
  join();
  EXPECT_EQ(given_up, (std::vector<std::string>{"r", "y"}));
  ASSERT_GE(claims.size(), 1U);
  EXPECT_EQ(claims[0].robot, "x");
  EXPECT_EQ(claims[0].epoch, 6U);
  EXPECT_EQ(claims[0].from, "gw-1");
  EXPECT_FALSE(ownership.may_act_for("x", at(now).mono)) << "gw-1 has not made way";
  comes_from_gw_1(Release{"x", {6, "gw-0", ownership.life()}, {}});
  EXPECT_TRUE(ownership.may_act_for("x", at(now).mono));
}

TEST_F(Joining, GivesUpARobotThatHasComeAndGone) {
  ownership.on_heard("x", at(now));
  comes_from_gw_1(ClaimRobot{"x", 6, {}});
  join();
  EXPECT_EQ(given_up, (std::vector<std::string>{"r", "x", "y"}));
  EXPECT_TRUE(claims.empty());
}

/// All boards of such a mesh hear it all the time.
TEST_F(Joining, GivesUpARobotOfASharedMeshThatAnotherGatewayServes) {
  ownership.on_heard_too("x", std::nullopt, at(now));
  join();
  EXPECT_EQ(given_up, (std::vector<std::string>{"r", "x", "y"}));
}

/// gw-1 has died with robot "x". This gateway claims it, and is cut off before it has won it.
class CutOffWhileItClaims : public Reconnected {
 protected:
  void SetUp() override {
    Reconnected::SetUp();
    others_answered(now);
    pass(5s);
    beat_of("gw-1", 0x20001, 500);
    ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"x", 1, {}}}, at(now));
    pass(3s);
    local = {{"x", true}};
    ownership.on_heard("x", at(now));
    pass(100ms);
    ASSERT_FALSE(ownership.may_act_for("x", at(now).mono));
    reconnect();
    others_answered(now);
  }
  void beat_of(const std::string& gateway, Life life, std::uint32_t period_ms) {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    ownership.on_fleet_message({gateway, life, Beat{sent_ms, period_ms, 0, 0, 9000, 9000}},
                               at(now));
  }
};

TEST_F(CutOffWhileItClaims, WithdrawsTheEntryOfTheDeadGatewayWhenItHasWonTheRobot) {
  pass(6s);
  ASSERT_TRUE(ownership.may_act_for("x", at(now).mono));
  EXPECT_EQ(dead_owners["x"], "gw-1");
}

TEST_F(CutOffWhileItClaims, WithdrawsTheEntryOfTheDeadGatewayWhenAThirdHasTheRobot) {
  beat_of("gw-2", 0x30001, 60'000);
  ownership.on_fleet_message({"gw-2", 0x30001, ClaimRobot{"x", 9, {}}}, at(now));
  EXPECT_TRUE(withdrawn.empty());
  pass(6s);
  EXPECT_EQ(given_up, std::vector<std::string>{"x"});
  EXPECT_EQ(withdrawn, std::vector<std::string>{"p/gateway/gw-1/robots/x"});
}

TEST_F(CutOffWhileItClaims, LeavesTheEntryOfAGatewayThatIsBackWithTheRobot) {
  beat_of("gw-1", 0x20002, 60'000);
  ownership.on_fleet_message({"gw-1", 0x20002, ClaimRobot{"x", 9, {}}}, at(now));
  pass(6s);
  EXPECT_EQ(given_up, std::vector<std::string>{"x"});
  EXPECT_TRUE(withdrawn.empty());
}

/// A process that has just started, with the session of robot "r" from before.
class Restarted : public Newcomer {
 protected:
  static Ownership gateway(Enabled enabled) {
    return {{"p", "gw-0"}, {enabled, process}, [] { return std::vector<LocalRobot>{{"r", true}}; }};
  }
  static bool announces(const Ownership& it, Duration after, bool has_just_come) {
    return it.may_announce("r", Presence::online, has_just_come, TimePoint{} + 1h + after);
  }
  static std::vector<std::string> taken_over(Ownership& it) {
    std::vector<std::string> robots;
    while (const auto action = it.next_action())
      if (const auto* taken = std::get_if<TakeOverRobot>(&*action)) robots.push_back(taken->robot);
    return robots;
  }
};

TEST_F(Restarted, AnnouncesItsRobotsWhenItKnowsThatItIsAlone) {
  Ownership it = gateway(Enabled::automatic);
  it.on_broker_link(true, at(0s));
  EXPECT_TRUE(announces(it, 0s, true)) << "nobody else has heard it since";
  EXPECT_FALSE(announces(it, 0s, false));
  EXPECT_TRUE(taken_over(it).empty());
  it.on_subscribe_result("p/gateway/+/state", SubscribeAnswer::granted, at(10ms));
  it.on_deadline(at(1100ms));
  EXPECT_EQ(taken_over(it), std::vector<std::string>{"r"});
  EXPECT_TRUE(announces(it, 2s, false));
  it.on_broker_link(false, at(3s));
  it.on_broker_link(true, at(20s));
  EXPECT_TRUE(announces(it, 20s, false)) << "it was alone before";
}

TEST_F(Restarted, AnnouncesItsRobotsAtOnceWhereNobodyAgrees) {
  Ownership it = gateway(Enabled::no);
  it.on_broker_link(true, at(0s));
  EXPECT_TRUE(announces(it, 0s, false));
}

/// It serves nobody, and says why.
TEST_F(Restarted, WarnsOnceInAnHourThatItCannotTakePartWhereItMust) {
  Ownership it = gateway(Enabled::yes);
  it.on_broker_link(true, at(0s));
  std::vector<Severity> told;
  for (Duration after{}; after < 90min; after += 100ms) {
    it.on_deadline(at(after));
    while (const auto action = it.next_action())
      if (const auto* notice = std::get_if<Notice>(&*action)) told.push_back(notice->severity);
  }
  EXPECT_EQ(told, (std::vector<Severity>{Severity::warning, Severity::warning}));
  EXPECT_EQ(it.phase(), Ownership::Phase::joining);
  EXPECT_EQ(it.missing_rights(at(90min).mono).size(), 1U);
}

TEST_F(Restarted, AnnouncesNoRobotWhileItAgreesWithOthers) {
  for (const auto enabled : {Enabled::automatic, Enabled::yes}) {
    Ownership it = gateway(enabled);
    it.on_broker_link(true, at(0s));
    it.on_broker_message(
        {"p/gateway/gw-1/state", to_bytes(R"({"state":"online"})"), Qos::at_least_once, true},
        at(10ms));
    ASSERT_EQ(it.phase(), Ownership::Phase::joining);
    EXPECT_FALSE(announces(it, 20ms, false));
    EXPECT_TRUE(taken_over(it).empty());
  }
}

}  // namespace
}  // namespace slamgw::fleet::test
