// SPDX-License-Identifier: Apache-2.0
// Commands, outcomes and wills of a member, where its words or those of others are lost.
#include "tests/fleet/looped_back.hpp"
#include "tests/fleet/will_of.hpp"

#include <optional>
#include <vector>

namespace slamgw::fleet::test {
namespace {

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
  lost = 3;
  command(now);
  pass(1500ms);
  const Taken theirs{7, CommandTurns::key_of({"p/server/r/cmd", {}, Qos::at_least_once, false}),
                     "r", "cmd", 1500};
  ownership.on_fleet_message({"gw-1", 0x20001, theirs}, at(now));
  while (said.size() < 3) pass(10ms);
  EXPECT_TRUE(said[2].is_refusal);
  pass(100ms);
  Taken objection = theirs;
  objection.age_ms = 2600;
  ownership.on_fleet_message({"gw-1", 0x20001, objection}, at(now));
  pass(10s);
  EXPECT_EQ(carried, 0);
  EXPECT_TRUE(ends.empty());
}

/// Each has heard that the other one takes it. The other one makes way.
TEST_F(LoopedBack, CommandThatTwoTakeAndNobodyCarriesOutIsRefused) {
  lost = 1;
  command(now);
  pass(500ms);
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{7, said.at(0).key, "r", "cmd"}}, at(now));
  pass(10s);
  EXPECT_EQ(carried, 0);
  ASSERT_EQ(ends.size(), 1U);
  EXPECT_EQ(ends[0].result, CommandResult::refused);
}

/// From gw-1 to this gateway, and on to gw-2, which may have missed what this one has heard.
TEST_F(LoopedBack, HandsOnWhatTheOwnerBeforeItHasDoneAlsoWhenItHeardSo) {
  const std::uint64_t key = CommandTurns::key_of({"p/server/r/cmd", {}, Qos::at_least_once, false});
  beat_of_gw_1(0);
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{7, key, "r", "cmd"}}, at(now));
  const Release from_gw_1{"r", {1, "gw-0", ownership.life()}, {}, {{7, key, "cmd", 100}}};
  ownership.on_fleet_message({"gw-1", 0x20001, from_gw_1}, at(now));
  pass(100ms);
  ownership.on_fleet_message({"gw-2", 0x30001, Beat{1, 500, 0, 0}}, at(now));
  ownership.on_fleet_message({"gw-2", 0x30001, ClaimRobot{"r", 99, "gw-0"}}, at(now));
  std::vector<DoneCommand> done;
  while (const auto action = ownership.next_action()) {
    if (const auto* given = std::get_if<GiveUpRobot>(&*action))
      ownership.on_given_up(given->robot, given->to, {}, at(now));
    const auto* said_now = std::get_if<PublishNow>(&*action);
    const auto message = said_now ? decode("gw-0", said_now->message.payload) : std::nullopt;
    if (message && std::holds_alternative<Release>(message->body))
      done = std::get<Release>(message->body).done;
  }
  ASSERT_EQ(done.size(), 1U);
  EXPECT_EQ(done[0].key, key);
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

/// The third gateway knows this one as the former, and not the dead one.
TEST_F(LoopedBack, WithdrawsTheEntryOfADeadGatewayAlsoWhenTheRobotMovesOnAtOnce) {
  const auto beat_of = [&](const std::string& gateway, Life life, std::uint32_t period_ms) {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    ownership.on_fleet_message({gateway, life, Beat{sent_ms, period_ms, 0, 0, 9000, 9000}},
                               at(now));
  };
  beat_of("gw-1", 0x20001, 500);
  beat_of("gw-2", 0x30001, 60'000);
  ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"x", 1, {}}}, at(now));
  pass(3s);
  ASSERT_FALSE(ownership.peers().is_alive("gw-1", at(now).mono));
  ownership.on_heard("x", at(now));
  pass(100ms);
  EXPECT_TRUE(withdrawn.empty()) << "it may be another gateway's yet";
  ownership.on_fleet_message({"gw-2", 0x30001, ClaimRobot{"x", 3, "gw-0"}}, at(now));
  pass(100ms);
  EXPECT_EQ(withdrawn, std::vector<std::string>{"p/gateway/gw-1/robots/x"});
}

TEST_F(LoopedBack, PublishesAWillOnlyWhenABusyBrokerHadTimeForAnAnswer) {
  pass(15s);               // gw-1 is no newcomer any more
  is_writing_lost = true;  // and written by hand, later
  ownership.on_will(will_of("r"), at(now));
  const TimePoint asked = at(now).mono;
  pass(900ms);
  ownership.on_fleet_message({"gw-0", ownership.life(), AskForSign{"r", 1}}, at(now));
  is_writing_lost = false;
  for (; wills == 0 && at(now).mono < asked + 10s;) pass(10ms);
  EXPECT_EQ(wills, 1);
  EXPECT_GE(at(now).mono - asked, 3600ms) << "four times as long as its own question took";
}

TEST_F(LoopedBack, AsksAgainWhenAQuestionWasLost) {
  pass(15s);  // gw-1 is no newcomer any more
  is_writing_lost = true;
  ownership.on_will(will_of("r"), at(now));
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

/// Others have forgotten their copies at its word, and do not tell the outcome of one who is back.
TEST_F(LoopedBack, RefusesWhatItTookBeforeItWasCutOff) {
  struct Cut {
    Duration pause;
    std::uint64_t others_up_ms;
    std::size_t refusals;
    const char* what;
  };
  for (const Cut& cut : {Cut{3s, 100'000, 1, "soon"},
                         Cut{27500ms, 100'000, 1, "in time, and a member only after that"},
                         Cut{35s, 100, 1, "too late, but so are the others"},
                         Cut{35s, 100'000, 0, "too late: gw-1 has told it"}}) {
    SCOPED_TRACE(cut.what);
    ends.clear();
    said.clear();
    lost = SIZE_MAX;
    command(now);
    pass(100ms);
    ASSERT_EQ(said.size(), 1U);
    now += cut.pause;
    pass(10ms);  // it notices that it was away
    lost = 0;
    beat_of_gw_1(cut.others_up_ms);
    pass(10s);
    EXPECT_EQ(carried, 0);
    EXPECT_EQ(ends.size(), cut.refusals);
    for (const EndCommand& end : ends) EXPECT_EQ(end.result, CommandResult::refused);
    ownership.on_heard("r", at(now));
    pass(10s);
    ASSERT_TRUE(ownership.may_act_for("r", at(now).mono));
  }
}

TEST_F(LoopedBack, DoesNotRefuseWhatItTookBeforeItWasCutOffWhenAnotherOneHasCarriedItOut) {
  lost = SIZE_MAX;
  command(now);
  pass(100ms);
  now += 3s;
  pass(10ms);
  lost = 0;
  beat_of_gw_1(100'000);
  while (said.size() < 2) pass(10ms);
  ASSERT_TRUE(said.back().is_refusal);
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, said[0].key, "r", "cmd", 3500}}, at(now));
  pass(20s);
  EXPECT_TRUE(ends.empty());
}

/// gw-1 was there when it came and took it; the word was lost to this gateway.
TEST_F(LoopedBack, LeavesWhatAnotherOneHadTimeToTakeAlsoWhenThatOneDiesThen) {
  come_back_to_a_command();
  const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  ownership.on_fleet_message({"gw-1", 0x20001, Beat{sent_ms, 3'000, 0, 0, 100'000, 100'000}},
                             at(now));
  pass(8900ms);
  ASSERT_TRUE(ownership.peers().is_alive("gw-1", at(now).mono));
  pass(20s);
  ASSERT_FALSE(ownership.peers().is_alive("gw-1", at(now).mono));
  EXPECT_TRUE(ends.empty());
}

/// The other one was cut off for a moment, at a broker that kept nothing for it.
TEST_F(LoopedBack, RefusesWhatCameBeforeItHeardTheOthersWhenTheyMayHaveMissedIt) {
  come_back_to_a_command();
  beat_of_gw_1(100'000, 5);
  pass(20s);
  EXPECT_EQ(ends.size(), 1U);
}

/// The broker has kept gw-1's claim while this gateway was cut off, but not its beats.
TEST_F(LoopedBack, GivesWayToWhoLivedWhenItsOwnLinkBroke) {
  const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  ownership.on_fleet_message({"gw-1", 0x20001, Beat{sent_ms, 500, 0, 0}}, at(now));
  pass(800ms);
  ownership.on_broker_link(false, at(now));
  now += 900ms;
  ownership.on_broker_link(true, at(now), true);
  ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"r", 99, "gw-0"}}, at(now));
  pass(100ms);
  EXPECT_EQ(ownership.phase(), Ownership::Phase::member);
  EXPECT_FALSE(ownership.may_act_for("r", at(now).mono));
}

/// An outcome is this gateway's until the broker has it.
TEST_F(LoopedBack, TellsAnOutcomeAgainThatTheBrokerHasNotAcknowledged) {
  const BrokerMessage outcome{"p/gateway/gw-0/commands/r", {}, Qos::at_least_once, false};
  const auto ids = [&] {
    std::vector<std::uint64_t> told_now;
    while (const auto action = ownership.next_action())
      if (const auto* tells = std::get_if<PublishOutcomeNow>(&*action))
        told_now.push_back(tells->id);
    return told_now;
  };
  ownership.on_own_outcome(outcome, 0s, at(now));
  ASSERT_EQ(ids().size(), 1U);
  ownership.on_broker_link(false, at(now));
  ownership.on_broker_link(true, at(now), true);
  ownership.on_deadline(at(now));
  const auto again = ids();
  ASSERT_EQ(again.size(), 1U);
  ownership.on_outcome_acknowledged(again[0]);
  ownership.on_broker_link(false, at(now));
  ownership.on_broker_link(true, at(now), true);
  ownership.on_deadline(at(now));
  EXPECT_TRUE(ids().empty());
}

/// gw-1 takes it, is cut off, and comes back with the outcome when this gateway has told one.
TEST_F(LoopedBack, ObjectsToALateOutcomeOfWhatItHasTold) {
  beat_of_gw_1(1000);
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, 7, "other", "cmd", 0}}, at(now));
  const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  ownership.on_fleet_message({"gw-1", 0x20002, Beat{sent_ms, 500, 0, 0}}, at(now));
  pass(40s);
  ASSERT_EQ(ends.size(), 1U) << "in its place";
  said.clear();
  ownership.on_fleet_message({"gw-1", 0x20003, Taken{2, 7, "other", "cmd", 40'000, true}}, at(now));
  pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_ended);
  EXPECT_FALSE(said[0].is_refusal);
}

/// Two refuse it, one of them yields, and dies a moment later.
TEST_F(LoopedBack, CommandThatTwoHaveTakenHasOneOutcome) {
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, 7, "other", "cmd", 8000, true}}, at(now));
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "other", "cmd", 8010, true}}, at(now));
  ownership.on_outcome("gw-2", "other", "cmd", at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
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

TEST_F(LoopedBack, GatewayThatRefusesLateWhatItTookInALifeBeforeOwesOneOutcome) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "r", "cmd", 0}}, at(now));
  pass(29s);
  ownership.on_fleet_message({"gw-2", 0x30002, Taken{2, 7, "r", "cmd", 29'000, true}}, at(now));
  ownership.on_outcome("gw-2", "r", "cmd", at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

/// A broker keeps no order between topics. Then gw-2 dies.
TEST_F(LoopedBack, OutcomeThatOvertakesItsTakenIsHeard) {
  ownership.on_outcome("gw-2", "r", "cmd", at(now));
  pass(100ms);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "r", "cmd", 0}}, at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{2, 7, "r", "cmd", 0}}, at(now));
  pass(60s);
  EXPECT_EQ(ends.size(), 1U) << "the next one was not told";
}

/// One outcome that fits no command must not make those that follow each other nobody's.
TEST_F(LoopedBack, OutcomeIsNotThatOfACommandThatCameLater) {
  for (std::uint64_t id = 1; id <= 5; ++id) {
    ownership.on_outcome("gw-2", "r", "cmd", at(now));
    pass(2s);
    ownership.on_fleet_message({"gw-2", 0x30001, Taken{id, id, "r", "cmd", 0}}, at(now));
    pass(100ms);
  }
  pass(60s);
  EXPECT_EQ(ends.size(), 1U) << "of the last one, to which none came";
}

/// Of a retained command, or of an operator's: nobody says that it is taken.
TEST_F(LoopedBack, OutcomeWithoutATakenIsNotTheNextCommands) {
  ownership.on_outcome("gw-2", "r", "cmd", at(now));
  pass(5s);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "r", "cmd", 0}}, at(now));
  pass(60s);
  EXPECT_EQ(ends.size(), 1U);
}

/// gw-2 wanted to refuse what gw-1 had carried out, and yields. Then it dies.
TEST_F(LoopedBack, GatewayThatYieldsWithItsRefusalOwesNoOutcome) {
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, 7, "r", "cmd", 0}}, at(now));
  ownership.on_outcome("gw-1", "r", "cmd", at(now));
  pass(9s);
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "r", "cmd", 9000, true}}, at(now));
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, 7, "r", "cmd", 9010}}, at(now));
  pass(60s);
  EXPECT_TRUE(ends.empty());
}

/// All were cut off, so nobody can have heard whether gw-2 has told the outcome. It lives and
/// knows.
TEST_F(LoopedBack, LeavesTheOutcomeToTheProcessThatTookItWhenAllWereCutOff) {
  ownership.on_fleet_message({"gw-2", 0x30001, Taken{1, 7, "r", "cmd", 0}}, at(now));
  now += 40s;
  pass(100ms);  // it notices that it was away
  const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  ownership.on_fleet_message({"gw-2", 0x30002, Beat{sent_ms, 60'000, 0, 0, 100}}, at(now));
  pass(30s);
  EXPECT_TRUE(ends.empty());
}

/// gw-2 says that it is online, and takes part only after 6 s. It may have the robot.
TEST_F(LoopedBack, AsksAGatewayThatHasJustComeBeforeItPublishesAWill) {
  pass(20s);
  const auto come = now;
  state_comes("gw-2", now, false);
  ownership.on_will(will_of("r"), at(now));
  pass(6s);
  EXPECT_EQ(wills, 0);
  const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  ownership.on_fleet_message({"gw-2", 0x30001, Beat{sent_ms, 60'000, 0, 0, 10}}, at(now));
  pass(2s);
  EXPECT_EQ(wills, 0);
  pass(2s);
  EXPECT_EQ(wills, 1);
  EXPECT_LT(now - come, 11s);
}

TEST_F(LoopedBack, TakesNoCopyForACommandBeforeItIsAMember) {
  now += 40s;
  pass(10ms);  // a new life
  ASSERT_EQ(ownership.phase(), Ownership::Phase::joining);
  const auto comes = [&](bool may_be_copy) {
    ownership.on_command({"p/server/r/cmd", {}, Qos::at_least_once, false}, "r", "cmd", at(now),
                         may_be_copy);
  };
  for (int copies = 0; copies < 2; ++copies) comes(true);
  pass(600ms);
  for (int copies = 0; copies < 2; ++copies) comes(true);
  pass(1500ms);
  ownership.on_heard("r", at(now));
  pass(1s);
  EXPECT_EQ(carried, 2);
  for (int equal = 0; equal < 2; ++equal) comes(true);
  pass(1s);
  EXPECT_EQ(carried, 4) << "a member has one subscription";
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

/// gw-1 took it too, was cut off, and is back after 28 s.
TEST_F(LoopedBack, OwnerObjectsAlsoWhenTheOtherOneRefusesLate) {
  command(now);
  pass(30s);
  ownership.on_command({"p/server/r/go", {}, Qos::at_least_once, false}, "r", "go", at(now));
  pass(4s);
  ASSERT_EQ(said.size(), 2U);
  ASSERT_EQ(carried, 2);
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{2, said[0].key, "r", "cmd", 34'000, true}},
                             at(now));
  pass(10ms);
  ASSERT_EQ(said.size(), 3U);
  EXPECT_EQ(said[2].id, said[0].id);
  EXPECT_FALSE(said[2].is_refusal);
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

/// gw-1 was cut off and is back; who sent the command sends it again at once.
TEST_F(LoopedBack, CarriesOutWhatIsSentAgainWhenAnotherOneRefusesWhatItTook) {
  const auto key = CommandTurns::key_of({"p/server/r/cmd", {}, Qos::at_least_once, false});
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, key, "r", "cmd", 0}}, at(now));
  command(now);
  pass(5s);
  ASSERT_EQ(carried, 0);
  ownership.on_fleet_message({"gw-1", 0x20002, Taken{1, key, "r", "cmd", 5000, true}}, at(now));
  command(now);
  pass(1s);
  EXPECT_EQ(carried, 1);
}

/// Both had said that they take it, and both are back.
TEST_F(LoopedBack, LeavesTheRefusalToAnotherOneThatTookTheCommandToo) {
  lost = SIZE_MAX;
  command(now);
  pass(100ms);
  ASSERT_EQ(said.size(), 1U);
  ownership.on_fleet_message({"gw-1", 0x20001, Taken{1, said[0].key, "r", "cmd", 100}}, at(now));
  now += 5s;
  pass(10ms);  // it notices that it was away
  lost = 0;
  beat_of_gw_1(100);
  ownership.on_fleet_message({"gw-1", 0x20002, Taken{1, said[0].key, "r", "cmd", 5110, true}},
                             at(now));
  pass(10s);
  EXPECT_TRUE(ends.empty());
}

/// Each node of the broker keeps retained messages for itself, or the broker sends none to a
/// wildcard, so that gw-2 saw nobody, and this one has not seen its own state.
TEST_F(LoopedBack, TellsAGatewayThatTakesNoPartThatItIsThere) {
  greetings = 0;
  state_comes("gw-2", now, false);
  pass(2s);
  EXPECT_EQ(greetings, 0) << "it may join by itself";
  pass(2s);
  EXPECT_EQ(greetings, 1);
  state_comes("gw-2", now, false);  // which does the same, and cannot be heard
  pass(30s);
  EXPECT_EQ(greetings, 1);
}

/// RabbitMQ. By then gw-2 has not yet decided that it is alone, and carries out no command.
TEST_F(LoopedBack, TellsItSoonWhereTheBrokerSendsNoRetainedStates) {
  ownership.on_broker_link(false, at(now));
  ownership.on_broker_link(true, at(now));
  greetings = 0;
  state_comes("gw-2", now, false);
  pass(900ms);
  EXPECT_EQ(greetings, 1);
}

/// Its last word is `offline`, and the newest one stays at the broker.
TEST_F(LoopedBack, GreetsNobodyWhenItEnds) {
  greetings = 0;
  state_comes("gw-2", now, false);
  ownership.on_stop();
  pass(10s);
  EXPECT_EQ(greetings, 0);
}

TEST_F(LoopedBack, GoesOnAloneWhenTheBrokerForbidsTheFleetLater) {
  is_writing_lost = true;
  ownership.on_broker_link(false, at(now));
  ownership.on_broker_link(true, at(now));
  pass(40s);
  EXPECT_FALSE(ownership.is_alone()) << "a cluster that elects a leader may be as slow";
  pass(25s);
  EXPECT_TRUE(ownership.is_alone());
}

}  // namespace
}  // namespace slamgw::fleet::test
