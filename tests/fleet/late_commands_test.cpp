// SPDX-License-Identifier: Apache-2.0
// Commands of which a broker delivers something late, or once more.
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

class LateCommands : public LoopedBack {
 protected:
  static constexpr Life life_of_gw_1 = 0x20001;
  static constexpr const char* robot = "x";  ///< gw-1's

  void SetUp() override {
    LoopedBack::SetUp();
    beat_of_gw_1(100'000);
    say(ClaimRobot{robot, 1, {}});
  }
  void say(const Body& body) { ownership.on_fleet_message({"gw-1", life_of_gw_1, body}, at(now)); }
  /// The connection has just come back; the command is for a robot of nobody.
  void refuse_what_the_broker_has_kept() {
    others_answered(now);
    pass(500ms);
    ownership.on_command({"p/server/y/cmd", {}, Qos::at_least_once, false}, "y", "cmd", at(now));
    for (int i = 0; i < 1000 && said.empty(); ++i) pass(10ms);
    ASSERT_EQ(said.size(), 1U);
  }
  void command_comes(bool is_dup = false) {
    BrokerMessage command{"p/server/x/cmd", {}, Qos::at_least_once, false};
    command.is_dup = is_dup;
    ownership.on_command(std::move(command), robot, "cmd", at(now));
  }
  std::int64_t clock_of_gw_1() const {
    return std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  }
  /// It has dealt with a command that came to it `age` ago.
  Release release_of(Duration age) const {
    const Claim to{2, "gw-0", ownership.life()};
    return {robot, to, {}, {{7, key, "cmd", to_age_ms(age)}}, clock_of_gw_1()};
  }
  /// gw-1 makes way at once, and names a command that came `age` ago.
  void take_over(Duration age, Duration wait) {
    ownership.on_heard(robot, at(now));
    pass(200ms);
    say(release_of(age));
    pass(wait);
    ASSERT_TRUE(ownership.may_act_for(robot, at(now).mono));
  }
  const std::uint64_t key = CommandTurns::key_of({"p/server/x/cmd", {}, Qos::at_least_once, false});
};

/// gw-1 carries it out, hands the robot over at once, and is heard 3 s later.
TEST_F(LateCommands, ReleaseThatComesLateTellsWhenTheCommandCame) {
  command_comes();
  pass(200ms);
  ownership.on_heard(robot, at(now));
  const Release release = release_of(200ms);
  pass(3s);
  say(release);
  pass(100ms);
  ASSERT_TRUE(ownership.may_act_for(robot, at(now).mono));
  pass(30s);
  EXPECT_EQ(carried, 0);
  EXPECT_TRUE(ends.empty());
}

/// gw-1 carries it out and hands the robot over at once.
TEST_F(LateCommands, CommandThatComesAfterTheReleaseThatNamesItIsDropped) {
  take_over(200ms, 1s);
  command_comes();
  pass(30s);
  EXPECT_EQ(carried, 0);
  command_comes();
  pass(1s);
  EXPECT_EQ(carried, 1) << "the next equal one";
}

/// This gateway was cut off for a moment when gw-1 took a command, and takes the robot over.
TEST_F(LateCommands, CopyThatNeverComesDoesNotCostTheNextEqualCommand) {
  say(Taken{7, key, robot, "cmd", 0});
  take_over(200ms, 4s);
  command_comes();
  pass(1s);
  EXPECT_EQ(carried, 1);
}

/// NATS says of the only copy that comes that it may have come before: its node had died.
TEST_F(LateCommands, CopyThatComesAsARepeatIsTheOneThatWasMissing) {
  say(Taken{7, key, robot, "cmd", 0});
  pass(1s);
  command_comes(true);
  take_over(1200ms, 1s);
  command_comes();
  pass(1s);
  EXPECT_EQ(carried, 1) << "the next equal one";
}

/// The connection breaks before the broker has this gateway's acknowledgement, and before its
/// Taken is out.
TEST_F(LateCommands, CommandThatComesAgainWhileItWaitsIsOne) {
  is_writing_lost = true;
  const auto comes = [&](bool is_dup) {
    BrokerMessage message{"p/server/r/cmd", {}, Qos::at_least_once, false};
    message.is_dup = is_dup;
    ownership.on_command(std::move(message), "r", "cmd", at(now));
  };
  comes(false);
  ownership.on_broker_link(false, at(now));
  now += 500ms;
  ownership.on_broker_link(true, at(now), true);
  comes(true);
  is_writing_lost = false;
  pass(20s);
  EXPECT_EQ(carried, 1);
  EXPECT_TRUE(ends.empty());
}

/// Its node of the cluster stood still when the command came. gw-1 has carried it out, and made way
/// for this gateway since; NATS delivers what was not acknowledged again after 30 s.
TEST_F(LateCommands, CommandThatTheBrokerDeliversAgainIsKnownForAMinute) {
  take_over(6600ms, 23400ms);
  command_comes(true);
  pass(30s);
  command_comes(true);
  pass(30s);
  EXPECT_EQ(carried, 0);
  command_comes();
  pass(1s);
  EXPECT_EQ(carried, 1) << "somebody says it once more";
}

TEST_F(LateCommands, OwnCommandThatTheBrokerDeliversAgainIsCarriedOutOnce) {
  const auto comes = [&](bool is_dup) {
    BrokerMessage message{"p/server/r/cmd", {}, Qos::at_least_once, false};
    message.is_dup = is_dup;
    ownership.on_command(std::move(message), "r", "cmd", at(now));
    pass(30s);
  };
  comes(true);
  EXPECT_EQ(carried, 1) << "nobody knows of it";
  comes(true);
  EXPECT_EQ(carried, 1);
  comes(false);
  EXPECT_EQ(carried, 2);
}

/// Two gateways have taken one command, and this one has got it once.
TEST_F(LateCommands, SecondTakenOfACommandDoesNotCancelTheNextOne) {
  command_comes();
  say(Taken{1, key, robot, "cmd", 0});
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, key, robot, "cmd", 10, true}}, at(now));
  ownership.on_heard(robot, at(now));
  pass(200ms);
  say(Release{robot, {2, "gw-0", ownership.life()}, {}});
  pass(1s);
  command_comes();
  pass(1s);
  EXPECT_EQ(carried, 1);
}

/// gw-1 wants to refuse what this gateway has carried out, and is heard 3 s later.
TEST_F(LateCommands, TakenThatComesLateTellsWhenTheCommandCame) {
  command(now);
  pass(8s);
  ASSERT_EQ(carried, 1);
  const Taken theirs{1, said.at(0).key, "r", "cmd", 8000, true, false, clock_of_gw_1()};
  pass(3s);
  say(theirs);
  pass(10ms);
  ASSERT_EQ(said.size(), 2U) << "it objects";
  EXPECT_EQ(said[1].id, said[0].id);
}

/// The broker has kept a command for this gateway, and what others said of it only if it had
/// granted the subscription to that before the connection broke.
TEST_F(LateCommands, KeptCommandIsRefusedWhenWhatOthersSaidOfItWasNotKept) {
  ownership.on_fleet_message({"gw-1", 0x20002, Beat{clock_of_gw_1(), 500, 0, 0, 100, 100}},
                             at(now));
  for (const bool has_heard_others : {false, true}) {
    carried = 0;
    said.clear();
    ownership.on_broker_link(false, at(now));
    ownership.on_broker_link(true, at(now));
    if (has_heard_others) others_answered(now);
    pass(5s);
    ownership.on_broker_link(false, at(now));
    now += 20s;
    ownership.on_broker_link(true, at(now), true);
    others_answered(now);
    command(now);
    pass(3s);  // until it takes part
    ownership.on_heard("r", at(now));
    pass(1500ms);
    EXPECT_EQ(carried, has_heard_others ? 1 : 0);
    ASSERT_FALSE(said.empty());
    EXPECT_EQ(said[0].is_refusal, !has_heard_others) << "who has carried it out objects";
    command(now);
    pass(1s);
    EXPECT_EQ(carried, has_heard_others ? 2 : 1) << "one of now";
  }
}

/// Two refusals of one gateway, one of which is told: another gateway has missed the first of them.
TEST_F(LateCommands, OutcomeIsThatOfTheCommandThatItsTimeFitsBest) {
  pass(10s);
  say(Taken{1, 7, "y", "cmd", 8000, true});
  pass(110ms);
  say(Taken{2, 8, "y", "cmd", 8000, true});
  pass(2500ms);
  ownership.on_outcome("gw-1", "y", "cmd", at(now), 10500ms);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 10'610, true}}, at(now));
  pass(10ms);
  EXPECT_TRUE(said.empty()) << "that one has no outcome";
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{2, 8, "y", "cmd", 10'510, true}}, at(now));
  pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_ended);
}

/// It was cut off with its outcome untold, and is back before it has heard who was there all the
/// time: gw-1, which leaves the command to it when it objects.
TEST_F(LateCommands, OutcomeIsNotClaimedBeforeItIsKnownWhoWasThere) {
  ownership.on_fleet_message({"gw-1", 0x20002, Beat{clock_of_gw_1(), 500, 0, 0, 100, 100}},
                             at(now));
  command(now);
  pass(1s);
  ASSERT_EQ(carried, 1);
  now += 33s;
  pass(50ms);  // it notices that it was away
  const Taken theirs{1, said.at(0).key, "r", "cmd", 34'000, true, false, clock_of_gw_1()};
  ownership.on_fleet_message({"gw-1", 0x20002, theirs}, at(now));
  pass(10ms);
  EXPECT_EQ(said.size(), 1U) << "it does not object";
  ownership.on_fleet_message({"gw-1", 0x20002, Beat{clock_of_gw_1(), 60'000, 0, 0, 100'000, 100}},
                             at(now));
  ownership.on_own_outcome(
      {"p/gateway/gw-0/commands/r", to_bytes(R"({"type":"cmd"})"), Qos::at_least_once, false}, 34s,
      at(now));
  pass(20s);
  EXPECT_EQ(told, 0);
}

/// gw-1 refuses two commands of one type, and has told the outcome of the first one. The broker
/// brings that again.
TEST_F(LateCommands, OutcomeThatComesAgainIsNotThatOfTheNextCommand) {
  const std::uint64_t next = CommandTurns::key_of({"p/server/x/cmd", {1}, Qos::at_least_once});
  say(Taken{7, key, robot, "cmd", 100, true});
  say(Taken{8, next, robot, "cmd", 0, true});
  BrokerMessage outcome{"p/gateway/gw-1/commands/x",
                        to_bytes(R"({"type":"cmd","outcome":"refused","after_ms":100})"),
                        Qos::at_least_once};
  ownership.on_broker_message(outcome, at(now));
  outcome.is_dup = true;
  ownership.on_broker_message(outcome, at(now));
  const auto objections_to = [&](std::uint64_t to) {
    said.clear();
    ownership.on_fleet_message({"gw-2", 0x30001, Taken{++taken_, to, robot, "cmd", 0, true}},
                               at(now));
    pass(10ms);
    return said.size();
  };
  EXPECT_EQ(objections_to(key), 1U);
  EXPECT_EQ(objections_to(next), 0U) << "it may have none";
}

/// It came before this gateway heard the others, so gw-1 sees to it that it has an outcome.
TEST_F(LateCommands, OutcomeThatItHasLeftToAnotherGatewayIsNotToldBySomebodyElse) {
  say(Taken{7, key, robot, "cmd", 6000, true});
  pass(1s);
  ownership.on_outcome("gw-1", robot, "cmd", at(now), 7s);
  pass(20s);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, key, robot, "cmd", 27'000, true}}, at(now));
  pass(10ms);
  ASSERT_EQ(said.size(), 1U) << "it objects";
  EXPECT_TRUE(said[0].is_ended);
}

/// gw-2 took it late, was cut off for 35 s and leaves its outcome to this gateway, which is cut off
/// in its turn before gw-2 would have been dead for long enough.
TEST_F(LateCommands, OutcomeThatIsLeftToThisGatewayIsToldAtOnce) {
  pass(10s);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 10'000, true}}, at(now));
  pass(25s);
  const auto sent_ms = clock_of_gw_1();
  ownership.on_fleet_message({"gw-2", 0x30002, Beat{sent_ms, 60'000, 0, 0, 100, 100}}, at(now));
  pass(5s);
  ASSERT_EQ(ends.size(), 1U);
  now += 10s;
  pass(30s);
  EXPECT_EQ(ends.size(), 1U);
}

/// Of two gateways to which it is left the first tells it, 30.5 s after the command.
TEST_F(LateCommands, OutcomeThatAnotherOneTellsInPlaceOfItsGatewayIsHeard) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0}}, at(now));
  pass(30500ms);
  const auto sent_ms = clock_of_gw_1();
  ownership.on_outcome("gw-1", "y", "cmd", at(now));
  ownership.on_fleet_message({"gw-2", 0x30002, Beat{sent_ms, 60'000, 0, 0, 100, 100}}, at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

/// This gateway has missed it; gw-1 has not.
TEST_F(LateCommands, OutcomeThatSomebodyHasHeardIsNotReplacedByATimeout) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0}}, at(now));
  pass(31500ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_refusal) << "it asks before it ends the command";
  EXPECT_TRUE(ends.empty());
  say(Taken{1, 7, "y", "cmd", to_age_ms(31500ms), false, true});
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

/// All were cut off, this gateway's new life began long before its beats came back, and gw-2 is
/// back a few seconds after it.
TEST_F(LateCommands, GatewayThatIsBackGivesTheOneThatTookACommandTimeToComeBackToo) {
  ownership.on_fleet_message({"gw-1", 0x20002, Beat{clock_of_gw_1(), 500, 0, 0, 100, 100}},
                             at(now));
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0}}, at(now));
  pass(100ms);
  is_writing_lost = true;
  pass(40s);
  is_writing_lost = false;
  pass(6s);
  EXPECT_TRUE(said.empty());
  const auto sent_ms = clock_of_gw_1();
  ownership.on_fleet_message({"gw-2", 0x30002, Beat{sent_ms, 60'000, 0, 0, 100, 100}}, at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

/// gw-1 wants to refuse what gw-2 has carried out, which is dead or cut off.
TEST_F(LateCommands, GatewayThatHasHeardAnOutcomeObjectsToAnother) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0}}, at(now));
  say(Taken{1, 7, "y", "cmd", 10, true});
  pass(10ms);
  EXPECT_TRUE(said.empty()) << "no outcome is known";
  ownership.on_outcome("gw-2", "y", "cmd", at(now));
  pass(8s);
  say(Taken{2, 7, "y", "cmd", 8000, true});
  pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_ended);
  EXPECT_FALSE(said[0].is_refusal);
}

/// A node of the cluster stood still: gw-2's words come after 5 s, its outcome another second
/// later.
TEST_F(LateCommands, GatewayThatHasHeardAnOutcomeLateObjectsToAnother) {
  const std::int64_t sent_ms = clock_of_gw_1();
  ownership.on_fleet_message({"gw-2", 0x30001, Beat{sent_ms, 500, 0, 0, 100, 100}}, at(now));
  pass(5s);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0, false, false, sent_ms}},
                             at(now));
  pass(1s);
  ownership.on_outcome("gw-2", "y", "cmd", at(now), 1ms);
  pass(30s);
  say(Taken{1, 7, "y", "cmd", 36'000, true});
  pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_ended);
}

/// The broker has not answered its other subscriptions yet.
TEST_F(LateCommands, GatewayThatHasJustConnectedObjectsForWhatHasAnOutcome) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "y", "cmd", 0}}, at(now));
  ownership.on_outcome("gw-2", "y", "cmd", at(now));
  is_writing_lost = true;
  pass(40s);
  ASSERT_FALSE(ownership.is_leased(at(now).mono));
  say(Taken{1, 7, "y", "cmd", 40'000, true});
  pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_ended);
}

/// It came to gw-1 only when that one was back.
TEST_F(LateCommands, OwnerObjectsToARefusalOfWhatTheBrokerKeptForTheOtherOne) {
  command(now);
  pass(20s);
  ASSERT_EQ(carried, 1);
  Taken theirs{1, said.at(0).key, "r", "cmd", 16'000, true};
  say(theirs);
  EXPECT_EQ(said.size(), 1U) << "it came 4 s later: another command";
  theirs.id = 2;
  theirs.kept_ms = 10'000;
  say(theirs);
  pass(10ms);
  ASSERT_EQ(said.size(), 2U);
  EXPECT_EQ(said[1].id, said[0].id);
}

TEST_F(LateCommands, WhatTheBrokerHasKeptWasKeptSinceAConnectionThatLasted) {
  ownership.on_broker_link(false, at(now));
  now += 10s;
  for (int flaps = 0; flaps < 3; ++flaps) {
    ownership.on_broker_link(true, at(now), true);
    now += 200ms;
    ownership.on_broker_link(false, at(now));
    now += 2s;
  }
  ownership.on_broker_link(true, at(now), true);
  ASSERT_NO_FATAL_FAILURE(refuse_what_the_broker_has_kept());
  EXPECT_EQ(said[0].kept_ms, 10'000U + 3 * 2200 + 500);
}

/// gw-1 has carried it out while this gateway was cut off.
TEST_F(LateCommands, RefusalOfWhatTheBrokerHasKeptYieldsToWhoGotItBefore) {
  ownership.on_broker_link(false, at(now));
  now += 1s;
  ownership.on_broker_link(true, at(now), true);
  ASSERT_NO_FATAL_FAILURE(refuse_what_the_broker_has_kept());
  ASSERT_TRUE(said[0].is_refusal);
  EXPECT_EQ(said[0].kept_ms, 1500U);
  const auto earlier = [&](std::uint64_t id) {
    say(Taken{id, said[0].key, "y", "cmd", said[0].age_ms + 1400});
  };
  earlier(1);
  pass(20s);
  EXPECT_TRUE(ends.empty());
  ownership.on_command({"p/server/y/cmd", {}, Qos::at_least_once, false}, "y", "cmd", at(now));
  said.clear();
  pass(9s);
  ASSERT_FALSE(said.empty());
  EXPECT_EQ(said[0].kept_ms, 0U);
}

/// This gateway carried it out, and was cut off for more than 30 s then. gw-1 was not.
TEST_F(LateCommands, OwnerThatWasAwayObjectsOnlyIfItHasPublishedTheOutcome) {
  for (const bool is_published : {false, true}) {
    SCOPED_TRACE(is_published);
    carried = 0;
    command(now);
    pass(100ms);
    ASSERT_EQ(carried, 1);
    const BrokerMessage outcome{"p/gateway/gw-0/commands/r", to_bytes(R"({"type":"cmd"})"),
                                Qos::at_least_once, false};
    if (is_published) ownership.on_own_outcome(outcome, 100ms, at(now));
    pass(100ms);
    now += 35s;
    pass(10ms);  // it notices that it was away
    beat_of_gw_1(100'000);
    pass(2s);
    const Taken theirs{++taken_, said.back().key, "r", "cmd", to_age_ms(37'210ms), true};
    said.clear();
    say(theirs);
    pass(10ms);
    ASSERT_EQ(said.size(), is_published ? 1U : 0U);
    for (const Taken& objection : said) EXPECT_TRUE(objection.is_ended);
    pass(10s);
    ownership.on_heard("r", at(now));
    pass(10s);
    ASSERT_TRUE(ownership.may_act_for("r", at(now).mono));
  }
}

/// All were cut off, and the broker has delivered it to each gateway when that one was back.
TEST_F(LateCommands, OfSeveralThatRefuseACommandOneDoesAlsoWhenItCameToThemAtOtherTimes) {
  ownership.on_command({"p/server/y/cmd", {}, Qos::at_least_once, false}, "y", "cmd", at(now));
  while (said.empty()) pass(10ms);
  ASSERT_TRUE(said[0].is_refusal);
  const Taken theirs{1, said[0].key, "y", "cmd", said[0].age_ms + 2000, true};
  ownership.on_fleet_message({"gw-2", 0x30001, theirs}, at(now));
  ownership.on_fleet_message({"gate", 0x40001, theirs}, at(now));
  pass(20s);
  EXPECT_TRUE(ends.empty()) << "the first name of all refuses it";
}

/// gw-1 has heard this gateway's refusal, which came out of its socket late, and yields to it. By
/// then this gateway has begun a new life.
TEST_F(LateCommands, RefusalOfAFormerLifeToWhichAnotherGatewayYieldsIsMadeGood) {
  ownership.on_command({"p/server/y/cmd", {}, Qos::at_least_once, false}, "y", "cmd", at(now));
  lost = 1;
  for (int i = 0; i < 2000 && said.empty(); ++i) pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  ASSERT_TRUE(said[0].is_refusal);
  const Life before = ownership.life();
  now += 3s;
  pass(10ms);
  ASSERT_NE(ownership.life(), before);
  say(Taken{1, said[0].key, "y", "cmd", said[0].age_ms + 4000, true});
  pass(20s);
  ASSERT_EQ(ends.size(), 1U);
  EXPECT_EQ(ends[0].robot, "y");
}

/// A robot that is driven by hand: each search among equal commands has its bound.
TEST(TakenCommands, FindsTheNewestOfManyEqualOnes) {
  TakenCommands commands;
  const TimePoint now{std::chrono::hours{1}};
  constexpr std::uint64_t count = 70'000;
  for (std::uint64_t id = 1; id <= count; ++id)
    commands.add({"r", {id, 7, "cmd"}, now, "gw-1", 1}, false, now);
  std::size_t asked = 0;
  const auto has = [&](std::uint64_t id) {
    return commands.find(7, [&](const TakenCommands::Entry& entry) {
      ++asked;
      return entry.command.id == id;
    });
  };
  EXPECT_TRUE(has(count));
  EXPECT_FALSE(has(1));
  EXPECT_LE(asked, 1024U);
  EXPECT_EQ(commands.of("r", now).size(), max_taken_commands);
}

/// The robot goes from gw-1 to gw-2 and on to this gateway, which has heard gw-1's Taken.
TEST_F(LateCommands, CommandThatIsHandedOnTwiceIsKnownOnce) {
  say(Taken{7, key, robot, "cmd", 0});
  command_comes();
  ownership.on_heard(robot, at(now));
  pass(200ms);
  Release release = release_of(200ms);
  ownership.on_fleet_message({"gw-2", 0x30001, release}, at(now));
  say(release);
  pass(1s);
  command_comes();
  pass(1s);
  EXPECT_EQ(carried, 1) << "the next equal one, and not taken for a copy";
}

/// A gateway that was started anew on another machine has another clock.
TEST_F(LateCommands, ClockOfAnotherProcessTellsNothing) {
  command(now);
  pass(8s);
  ownership.on_fleet_message(
      {"gw-1", 0x990001, Taken{1, said.at(0).key, "r", "cmd", 8000, true, false, 1}}, at(now));
  pass(10ms);
  EXPECT_EQ(said.size(), 2U);
}

}  // namespace
}  // namespace slamgw::fleet::test
