// SPDX-License-Identifier: Apache-2.0
// PUBLISH to clients (R85-R93), and the outcome of commands.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

/// A client that has subscribed to "a/x" at QoS 2; its id is 1.
struct DownlinkRig : SnRig {
  explicit DownlinkRig(bool clean = true, std::uint16_t keep_alive_s = 6000) {
    connect(1, "r1", clean, keep_alive_s);
    subscribe(1, "a/x", 2);
  }
};

TEST(SnGateway, R85_UsesTheKindOfIdThatTheClientSubscribedWith) {
  Settings settings;
  settings.predefined_topics = {{7, "a/seven", {}}};
  ConnectedRig rig(settings);
  rig.subscribe(1, "a/name", 0);
  rig.send(1, Subscribe{false, WireQos::zero, TopicIdType::predefined, 2, "", 7});
  rig.send(1, Subscribe{false, WireQos::zero, TopicIdType::short_name, 3, "", 0x6162});
  rig.sent_to(1);
  for (const char* topic : {"a/name", "a/seven", "ab"}) rig.broker(topic);
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=6869",
                                   "PUBLISH dup=0 qos=0 retain=0 predefined id=7 msg=0 data=6869",
                                   "PUBLISH dup=0 qos=0 retain=0 short id=24930 msg=0 data=6869"}));
}

/// A message's topic may be longer or shorter than the two octets of such a filter.
TEST(SnGateway, R96_RefusesAWildcardAsAShortTopicName) {
  SnRig rig({}, {}, {}, {"#"});
  rig.connect(1, "r1");
  constexpr std::uint16_t wildcards[] = {0x2f23, 0x2b2f, 0x2b2b};  // "/#", "+/", "++"
  for (const std::uint16_t wildcard : wildcards) {
    rig.send(1, Subscribe{false, WireQos::one, TopicIdType::short_name, 3, "", wildcard});
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=3 code=3");
  }
  EXPECT_TRUE(rig.subscribes.empty());
  rig.robot_message({"r1", {"/", to_bytes("hi"), Qos::at_most_once}});
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R86_RegistersATopicAgainThatTheClientForgot) {
  DownlinkRig rig;
  rig.broker("a/x", "hi", 1);
  rig.sent_to(1);
  rig.send(1, Puback{1, 1, ReturnCode::invalid_topic_id});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=2 topic=a/x"});
  rig.send(1, Regack{1, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=3 data=6869"});
  rig.send(1, Puback{1, 3, ReturnCode::invalid_topic_id});
  EXPECT_TRUE(rig.is_silent(1)) << "registered again only once";
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
}

TEST(SnGateway, R86_RegistersAForgottenTopicAgainAtQos0) {
  DownlinkRig rig;
  rig.broker("a/x", "hi", 0);
  rig.sent_to(1);
  rig.send(1, Puback{1, 0, ReturnCode::invalid_topic_id});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=1 topic=a/x"});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=6869"});
  rig.send(1, Puback{1, 0, ReturnCode::invalid_topic_id});
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R86_WaitsForACongestedClientAndDropsRefusedMessages) {
  DownlinkRig rig;
  rig.broker("a/x", "1", 1);
  rig.send(1, Puback{1, 1, ReturnCode::congestion});
  rig.sent_to(1);
  rig.broker("a/x", "2", 0);
  rig.pass(limits::t_wait - std::chrono::seconds(1));
  EXPECT_TRUE(rig.is_silent(1));
  rig.pass_s(2);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=1 qos=1 retain=0 normal id=1 msg=1 data=31");
  rig.send(1, Puback{1, 1, ReturnCode::not_supported});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=1 data=31")
      << "repeated without DUP, which the client may have refused";
  rig.send(1, Puback{1, 1, ReturnCode::not_supported});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=32"});
  rig.broker("a/x", "3", 1);
  rig.send(1, Puback{1, 2, static_cast<ReturnCode>(9)});
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
}

TEST(SnGateway, ReportsCongestionAsTheReasonOfATimeout) {
  ConnectedRig rig;
  rig.subscribe(1, r1_command, 1);
  for (int i = 0; i < 2; ++i) rig.broker(r1_command, "go", 1);
  rig.send(1, Puback{1, 1, ReturnCode::congestion});
  rig.pass(limits::command_patience);
  ASSERT_EQ(rig.outcomes.size(), 2U);
  for (const CommandOutcome& each : rig.outcomes) {
    EXPECT_EQ(each.result, CommandResult::timeout);
    EXPECT_EQ(each.why, "the robot says that it is congested");
  }
}

TEST(SnGateway, R87_DeliversAtTheLowerQos) {
  ConnectedRig rig;
  rig.subscribe(1, "a/0", 0);
  rig.subscribe(1, "a/1", 1);
  rig.broker("a/0", "x", 2);
  EXPECT_NE(rig.last_to(1).find("qos=0"), std::string::npos);
  rig.broker("a/1", "x", 2);
  EXPECT_NE(rig.last_to(1).find("qos=1"), std::string::npos);
  rig.send(1, Puback{2, 1, ReturnCode::accepted});
  rig.broker("a/1", "x", 0);
  EXPECT_NE(rig.last_to(1).find("qos=0"), std::string::npos);
}

TEST(SnGateway, R88_RepeatsQos1WithDupAndQos2InBothHalves) {
  DownlinkRig rig;
  constexpr auto wait = RetransmissionTimeout::initial;
  rig.broker("a/x", "1", 1);
  rig.pass(wait - std::chrono::milliseconds(1));
  EXPECT_EQ(rig.sent_to(1).size(), 1U);
  rig.pass(std::chrono::milliseconds(1));
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=1 qos=1 retain=0 normal id=1 msg=1 data=31"});
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  rig.broker("a/x", "2", 2);
  rig.pass(2 * wait);
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBLISH dup=0 qos=2 retain=0 normal id=1 msg=2 data=32",
                                   "PUBLISH dup=1 qos=2 retain=0 normal id=1 msg=2 data=32"}));
  rig.send(1, Pubrec{2});
  rig.pass(3 * wait);
  EXPECT_EQ(rig.sent_to(1), Lines(2, "PUBREL msg=2"));
  rig.send(1, Pubcomp{2});
  rig.pass_s(100);
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R89_AcceptsAPubackAsTheEndOfAQos2Delivery) {
  DownlinkRig rig;
  rig.broker("a/x", "2", 2);
  rig.sent_to(1);
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  rig.pass_s(100);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
}

TEST(SnGateway, R90_NumbersMessagesOfEachClientFrom1To32767) {
  DownlinkRig before;
  before.connect(2, "r2");
  before.subscribe(2, "a/x", 1);
  auto worn = *before.gateway.snapshot("r1", before.now);
  worn.last_msg_id = 32766 - 256;  // the MsgIds that are skipped at a restart
  SnRig rig;
  ASSERT_TRUE(rig.gateway.restore(worn, rig.now));
  ASSERT_TRUE(rig.gateway.restore(*before.gateway.snapshot("r2", before.now), rig.now));
  for (const std::uint16_t msg_id : {std::uint16_t{32767}, std::uint16_t{1}, std::uint16_t{2}}) {
    rig.broker("a/x", "x", 1);
    EXPECT_NE(rig.last_to(1).find("msg=" + std::to_string(msg_id) + " "), std::string::npos);
    rig.send(1, Puback{1, msg_id, ReturnCode::accepted});
  }
  EXPECT_NE(rig.last_to(2).find("msg=1 "), std::string::npos) << "each client has its own numbers";
}

/// Only an answer to a MsgId from after the restart shows that the client receives.
TEST(SnGateway, R90_RecognizesMsgIdsSinceARestartAcrossTheWrap) {
  for (const int random : {0, 1, 0x7ffd, 0x7ffe, 0x7fff, 0x8000, 0xffff}) {
    Delivery delivery;
    restart_message_ids(delivery, static_cast<std::uint16_t>(random));
    const std::uint16_t first = next_message_id(delivery);
    const std::uint16_t second = next_message_id(delivery);
    for (const int msg_id : {first - 1, second + 1, first | 0x8000})
      EXPECT_FALSE(is_since_restart(delivery, static_cast<std::uint16_t>(msg_id))) << msg_id;
    for (const std::uint16_t msg_id : {first, second})
      EXPECT_TRUE(is_since_restart(delivery, msg_id)) << random << ": " << msg_id;
  }
}

TEST(SnGateway, R91_HasOneDeliveryInFlightAndKeepsTheOrder) {
  DownlinkRig rig;
  for (const char* payload : {"1", "2", "3"}) rig.broker("a/x", payload, 1);
  rig.broker("a/x", "4", 0);
  Lines all = rig.sent_to(1);
  EXPECT_EQ(all.size(), 1U);
  for (std::uint16_t i = 1; i <= 3; ++i) {
    rig.send(1, Puback{1, i, ReturnCode::accepted});
    for (const std::string& line : rig.sent_to(1)) all.push_back(line);
  }
  ASSERT_EQ(all.size(), 4U);
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_NE(all[i].find("data=3" + std::to_string(i + 1)), std::string::npos);
}

TEST(SnGateway, R92_IgnoresUnexpectedAcksAndAnswersUnknownPubrec) {
  DownlinkRig rig;
  rig.send(1, Puback{1, 50, ReturnCode::accepted});
  rig.send(1, Pubcomp{50});
  EXPECT_TRUE(rig.is_silent(1));
  rig.send(1, Pubrec{50});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBREL msg=50"});
}

TEST(SnGateway, R93_SendsNothingToSleepingDisconnectedOrLostClients) {
  DownlinkRig rig(false);
  rig.sleep(1, 1000);
  rig.broker("a/x", "1", 1);
  rig.pass_s(100);
  EXPECT_TRUE(rig.is_silent(1));
  rig.send(1, Disconnect{});
  rig.sent_to(1);
  rig.broker("a/x", "2", 1);
  rig.pass_s(100);
  EXPECT_TRUE(rig.is_silent(1));
  DownlinkRig lost(false, 60);
  lost.pass_s(91);
  lost.broker("a/x", "3", 1);
  lost.pass_s(100);
  EXPECT_TRUE(lost.is_silent(1));
}

TEST(SnGateway, ReportsTheOutcomeOfEachCommandOnce) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  ConnectedRig rig(false, 6000);
  rig.subscribe(1, command, 1);
  rig.broker(command, "0", 0);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::sent) << "QoS 0 has no acknowledgement";
  EXPECT_EQ(rig.outcomes[0].type, "cmd");
  EXPECT_EQ(rig.outcomes[0].id, CommandId{1});
  rig.broker(command, "1", 1);
  EXPECT_EQ(rig.outcomes.size(), 1U);
  rig.pass_s(3);
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 2U);
  EXPECT_EQ(rig.outcomes[1].result, CommandResult::delivered);
  EXPECT_EQ(rig.outcomes[1].id, CommandId{2});
  EXPECT_EQ(rig.outcomes[1].after, std::chrono::seconds(3));
  rig.broker(command, "2", 1);
  rig.pass_s(30);
  ASSERT_EQ(rig.outcomes.size(), 3U);
  EXPECT_EQ(rig.outcomes[2].result, CommandResult::timeout);
  rig.send(1, Puback{1, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.outcomes.size(), 3U);
  rig.broker(command, "3", 1);
  rig.send(1, Puback{1, 3, ReturnCode::not_supported});
  ASSERT_EQ(rig.outcomes.size(), 4U);
  EXPECT_EQ(rig.outcomes[3].result, CommandResult::refused);
}

TEST(SnGateway, CountsEarlierWaitingTowardsTheTimeoutOfACommand) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  ConnectedRig rig(false, 6000);
  rig.subscribe(1, command, 1);
  rig.broker(command, "fresh", 1);
  const auto comes_after = [&](const std::string& topic, std::chrono::seconds waited) {
    rig.robot_message({"r1",
                       {topic, to_bytes("go"), Qos::at_least_once, false, {}, waited},
                       CommandId{7},
                       topic != command});
  };
  comes_after(command, std::chrono::seconds(5));
  rig.pass(std::chrono::milliseconds(23'900));
  EXPECT_TRUE(rig.outcomes.empty());
  rig.pass(std::chrono::milliseconds(200));
  ASSERT_EQ(rig.outcomes.size(), 1U) << "times out 29 s after its arrival, before the fresh one";
  EXPECT_EQ(rig.outcomes[0].id, CommandId{7});
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
  EXPECT_EQ(rig.outcomes[0].after, std::chrono::seconds(29));
  rig.pass_s(6);
  EXPECT_EQ(rig.outcomes.size(), 2U);
  comes_after("ntnu-slam/server/r1/run", std::chrono::seconds(4));
  ASSERT_EQ(rig.outcomes.size(), 3U);
  EXPECT_EQ(rig.outcomes[2].result, CommandResult::refused);
  EXPECT_EQ(rig.outcomes[2].after, std::chrono::seconds(4));
}

TEST(SnGateway, TimesOutALateCommandWithoutSendingIt) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  ConnectedRig rig;
  rig.subscribe(1, command, 1);
  rig.sent_to(1);
  rig.robot_message(
      {"r1",
       {command, to_bytes("go"), Qos::at_least_once, false, {}, std::chrono::seconds(29)},
       CommandId{7}});
  EXPECT_TRUE(rig.is_silent(1));
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
}

/// The command was reported as sent, so it must not arrive hours later.
TEST(SnGateway, DropsARefusedQos0CommandBeforeTheNextWakeUp) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  ConnectedRig rig;
  rig.subscribe(1, command, 0);
  rig.sleep(1, 300);
  rig.broker(command, "go", 0);
  rig.send(1, Pingreq{"r1"});
  rig.sent_to(1);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::sent);
  rig.send(1, Puback{1, 0, ReturnCode::invalid_topic_id});
  rig.pass_s(100);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
}

TEST(SnGateway, WithdrawsACommandThatASleepingRobotDoesNotFetchInTime) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  ConnectedRig rig;
  rig.subscribe(1, command, 1);
  rig.sleep(1, 300);
  rig.broker(command, "go", 0);
  rig.pass_s(31);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
  EXPECT_NE(rig.outcomes[0].why.find("sleeps"), std::string::npos);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"}) << "the timeout was reported, so it is not sent";
  EXPECT_EQ(rig.outcomes.size(), 1U);
}

TEST(SnGateway, RefusesCommandsThatTheRobotHasNotSubscribedTo) {
  ConnectedRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/run", 1);
  rig.broker("ntnu-slam/server/r1/cmd", "go", 1);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].id, CommandId{1});
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::refused);
  EXPECT_EQ(rig.outcomes[0].why, "the robot has not subscribed to ntnu-slam/server/r1/cmd");
  rig.connect(2, "r2", false);
  rig.broker("ntnu-slam/server/r2/cmd", "go", 1);
  ASSERT_EQ(rig.outcomes.size(), 2U) << "with a kept session, too";
  EXPECT_EQ(rig.outcomes[1].result, CommandResult::refused);
}

/// A copy from the robot's own subscription may follow.
TEST(SnGateway, RefusesACommandOutsideTheRobotsSubscription) {
  ConnectedRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/cmd", 0);
  rig.robot_message({"r1",
                     {"ntnu-slam/server/r1/cmd", to_bytes("go"), Qos::at_most_once},
                     CommandId{7},
                     /*is_unasked=*/true});
  EXPECT_TRUE(rig.is_silent(1));
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::refused);
}

TEST(SnGateway, RefusesACommandForARobotWithoutASession) {
  SnRig rig;
  rig.robot_message(
      {"r1", {"ntnu-slam/server/r1/cmd", to_bytes("go"), Qos::at_most_once}, CommandId{7}});
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].id, CommandId{7});
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::refused);
}

TEST(SnGateway, TimesOutSentAndRefusesUnsentCommandsOfANewSession) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  ConnectedRig rig;
  rig.subscribe(1, command, 1);
  rig.broker(command, "sent", 1);
  rig.broker(command, "waits", 1);
  rig.connect(1, "r1");
  ASSERT_EQ(rig.outcomes.size(), 2U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
  EXPECT_EQ(rig.outcomes[0].why, "the robot has begun a new session");
  EXPECT_EQ(rig.outcomes[1].result, CommandResult::refused);
}

/// A process that was stopped handles waiting datagrams before its timers.
TEST(SnGateway, SendsNoPubrelAfterTheTimeoutOfACommand) {
  ConnectedRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/cmd", 2);
  rig.broker("ntnu-slam/server/r1/cmd", "go", 2);
  const auto sent = std::get<Publish>(*decode(rig.datagrams.back().bytes));
  rig.sent_to(1);
  rig.now += limits::command_patience;
  rig.send(1, Pubrec{sent.msg_id});
  EXPECT_TRUE(rig.is_silent(1)) << "a PUBREL would release the command";
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
}

/// The client is lost after 15 s, or disconnects. Its session is kept in both cases.
TEST(SnGateway, TimesOutCommandsOfALostOrDisconnectedClient) {
  for (const bool is_lost : {true, false}) {
    ConnectedRig rig(false, 10);
    rig.subscribe(1, "ntnu-slam/server/r1/+", 1);
    rig.broker("ntnu-slam/server/r1/cmd", "1", 1);
    rig.broker("ntnu-slam/server/r1/run", "1", 1);
    if (!is_lost) rig.send(1, Disconnect{});
    rig.pass_s(28);
    EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
    EXPECT_TRUE(rig.outcomes.empty());
    rig.pass_s(1);
    ASSERT_EQ(rig.outcomes.size(), 2U);
    for (const CommandOutcome& outcome : rig.outcomes)
      EXPECT_EQ(outcome.result, CommandResult::timeout);
    EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
  }
}

TEST(SnGateway, ReportsNoOutcomeForAnotherClientsCopyOfACommand) {
  SnRig rig({}, {}, {}, {"ntnu-slam/server/#"});
  rig.connect(1, "watcher");
  rig.subscribe(1, "ntnu-slam/server/#", 0);
  rig.broker("ntnu-slam/server/r1/cmd", "go", 0);
  EXPECT_FALSE(rig.is_silent(1));
  EXPECT_TRUE(rig.outcomes.empty());
}

}  // namespace
}  // namespace slamgw::mqttsn
