// SPDX-License-Identifier: Apache-2.0
// Commands to robots: messages, repeats, and exactly one outcome for each command.
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

class Downlink : public ::testing::Test {
 protected:
  explicit Downlink(Settings settings = {}) : rig(std::move(settings)) { rig.start(); }

  std::vector<CommandOutcome> outcomes() const { return rig.all<CommandOutcome>(); }
  std::vector<std::string> sent() {
    rig.run_for(20ms);
    return rig.sent_to(first_robot);
  }

  MeshRig rig;
};

TEST_F(Downlink, SendsAPositionAndReportsItsDelivery) {
  rig.command("nr1/cmd", hex("0a 00 ec ff"));
  EXPECT_EQ(sent(), std::vector<std::string>{"cd59000a00ecff"});
  EXPECT_TRUE(outcomes().empty());
  rig.run_for(80ms);
  rig.hear(first_robot, "d0 59 00 00");
  ASSERT_EQ(outcomes().size(), 1u);
  EXPECT_EQ(outcomes()[0].robot, "nr1");
  EXPECT_EQ(outcomes()[0].type, "cmd");
  EXPECT_EQ(outcomes()[0].result, CommandResult::delivered);
  EXPECT_EQ(outcomes()[0].after, 100ms);
  rig.run_for(60s);
  EXPECT_EQ(rig.sent_to(first_robot).size(), 1u);
  EXPECT_EQ(outcomes().size(), 1u);
}

TEST_F(Downlink, RepeatsOnReliablePublishsScheduleUntilTheTimeLimit) {
  rig.command("nr1/cmd", hex("0a 00 ec ff"));
  std::size_t expected = 1;
  for (const auto offset : {280ms, 560ms, 1120ms, 2240ms, 4480ms, 8960ms, 17920ms}) {
    const TimePoint due = TimePoint{} + 1s + offset;
    rig.run_for(due - rig.now - 10ms);
    EXPECT_EQ(rig.sent_to(first_robot).size(), expected) << offset.count();
    rig.run_for(20ms);
    EXPECT_EQ(rig.sent_to(first_robot).size(), ++expected) << offset.count();
  }
  rig.run_for(20s);
  ASSERT_EQ(outcomes().size(), 1u);
  EXPECT_EQ(outcomes()[0].result, CommandResult::timeout);
  EXPECT_LE(outcomes()[0].after, 30s);
  EXPECT_EQ(outcomes()[0].why, "the robot did not answer");
}

TEST_F(Downlink, TimeLimitIncludesWaitInGateway) {
  rig.command("nr1/cmd", hex("0a 00 ec ff"), false, 5s);
  rig.command("nr1/hello", to_bytes("waits behind it"), false, 4s);
  rig.run_for(23900ms);
  EXPECT_TRUE(outcomes().empty());
  rig.run_for(200ms);
  ASSERT_EQ(outcomes().size(), 1u) << "29 s after it came to the gateway";
  EXPECT_EQ(outcomes()[0].result, CommandResult::timeout);
  EXPECT_EQ(outcomes()[0].after, 29s);
  rig.run_for(1s);
  ASSERT_EQ(outcomes().size(), 2u);
  EXPECT_EQ(outcomes()[1].result, CommandResult::timeout);
  rig.command("nr1/cmd", hex("0a"), false, 3s);
  ASSERT_EQ(outcomes().size(), 3u);
  EXPECT_EQ(outcomes()[2].result, CommandResult::refused);
  EXPECT_EQ(outcomes()[2].after, 3s);
}

TEST_F(Downlink, SendsOtherTypesThroughMinCom) {
  rig.command("nr1/hello", to_bytes("hi"));
  EXPECT_EQ(sent(), std::vector<std::string>{"c559006869"});
  rig.hear(first_robot, "d0 59 00 00");  // another model's STATUS
  EXPECT_TRUE(outcomes().empty());
  rig.hear(first_robot, "c8 59 00 00");
  EXPECT_EQ(outcomes().size(), 1u);
}

TEST_F(Downlink, RunIsAnOnOffSetWithANewTidEachTimeAndTheSameForRepeats) {
  rig.command("nr1/run", to_bytes("start"));
  rig.run_for(300ms);
  ASSERT_EQ(sent().size(), 2u);
  EXPECT_EQ(rig.sent_to(first_robot)[0], "82020101");
  EXPECT_EQ(rig.sent_to(first_robot)[1], "82020101");
  rig.hear(first_robot, "82 04 01");
  rig.command("nr1/run", to_bytes("0"));
  rig.run_for(300ms);  // the first one's repeat may be answered, too
  EXPECT_EQ(sent().back(), "82020002");
  EXPECT_EQ(outcomes().size(), 1u);
}

TEST_F(Downlink, SendsOneCommandAtATimeInOrder) {
  rig.command("nr1/a", to_bytes("1"));
  rig.command("nr1/b", to_bytes("2"));
  EXPECT_EQ(sent().size(), 1u);
  rig.hear(first_robot, "c8 59 00 00");
  EXPECT_EQ(sent(), (std::vector<std::string>{"c5590031", "c5590032"}));
}

TEST_F(Downlink, ANewerPositionReplacesOneThatWasNotSent) {
  rig.command("nr1/cmd", hex("01 00 01 00"));
  rig.run_for(20ms);
  rig.command("nr1/cmd", hex("02 00 02 00"));
  rig.command("nr1/cmd", hex("03 00 03 00"));
  ASSERT_EQ(outcomes().size(), 1u);
  EXPECT_EQ(outcomes()[0].result, CommandResult::superseded);
  EXPECT_EQ(outcomes()[0].id, CommandId{2});
  rig.hear(first_robot, "d0 59 00 00");
  ASSERT_EQ(outcomes().size(), 2u);
  EXPECT_EQ(outcomes()[1].id, CommandId{1});
  EXPECT_EQ(sent(), (std::vector<std::string>{"cd590001000100", "cd590003000300"}));
}

TEST_F(Downlink, RefusesInvalidPayloadsWithReason) {
  rig.command("nr1/cmd", to_bytes("10,-20"));
  rig.command("nr1/run", to_bytes("jump"));
  rig.command("nr1/blob", Bytes(242, 1));
  ASSERT_EQ(outcomes().size(), 3u);
  for (const auto& outcome : outcomes()) EXPECT_EQ(outcome.result, CommandResult::refused);
  EXPECT_NE(outcomes()[0].why.find("4 bytes"), std::string::npos);
  EXPECT_NE(outcomes()[1].why.find("unpause"), std::string::npos);
  EXPECT_NE(outcomes()[2].why.find("241"), std::string::npos);
  rig.command("nr1/blob", Bytes(241, 1));
  EXPECT_EQ(outcomes().size(), 3u);
}

TEST_F(Downlink, TheQueueIsBounded) {
  for (std::size_t i = 0; i < 1 + CommandQueue::max_waiting; ++i)
    rig.command("nr1/x", Bytes{static_cast<std::uint8_t>(i)});
  EXPECT_TRUE(outcomes().empty());
  rig.command("nr1/x", Bytes{99});
  ASSERT_EQ(outcomes().size(), 1u);
  EXPECT_EQ(outcomes()[0].result, CommandResult::refused);
  rig.run_for(30s);
  EXPECT_EQ(outcomes().size(), 2u + CommandQueue::max_waiting) << "one outcome for each";
}

TEST_F(Downlink, RefusesWhileTheLinkIsDownAndWhenItGoesDown) {
  rig.command("nr1/x", to_bytes("1"));
  rig.command("nr1/x", to_bytes("2"));
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  ASSERT_EQ(outcomes().size(), 2u);
  EXPECT_EQ(outcomes()[0].result, CommandResult::timeout) << "the robot may have carried it out";
  EXPECT_EQ(outcomes()[1].result, CommandResult::refused);
  for (const CommandOutcome& outcome : outcomes())
    EXPECT_NE(outcome.why.find("unplugged"), std::string::npos);
  rig.command("nr1/x", to_bytes("3"));
  ASSERT_EQ(outcomes().size(), 3u);
  EXPECT_EQ(outcomes()[2].result, CommandResult::refused);
}

class DownlinkAtTheStart : public ::testing::Test {
 protected:
  DownlinkAtTheStart() {
    rig.mesh.on_start();
    rig.command("nr1/x", to_bytes("1"));
    rig.run_for(300ms);
  }

  MeshRig rig;
};

TEST_F(DownlinkAtTheStart, CommandWaitsForTheRadio) {
  rig.open();
  rig.run_for(1s);
  ASSERT_TRUE(rig.is_up());
  EXPECT_TRUE(rig.all<CommandOutcome>().empty());
  ASSERT_FALSE(rig.sent_to(first_robot).empty());
  EXPECT_EQ(rig.sent_to(first_robot)[0], "c5590031");
}

TEST_F(DownlinkAtTheStart, CommandIsRefusedWhenThePortCannotBeOpened) {
  rig.mesh.on_port_closed("no such file", rig.now);
  rig.run_for(1ms);
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  EXPECT_NE(outcomes[0].why.find("no such file"), std::string::npos);
}

/// A message does not show whether the broker retains it. A subscription makes the broker send it
/// again, which would start a robot that was stopped since.
TEST_F(Downlink, DoesNotSubscribeAgainWithLinkWhenNothingWasMissed) {
  rig.hear(first_robot, "04 00 59 00");
  const std::size_t before = rig.all<SubscribeRequest>().size();
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.mesh.on_port_open(rig.now);
  rig.run_for(5s);
  ASSERT_TRUE(rig.is_up());
  EXPECT_EQ(rig.all<SubscribeRequest>().size(), before);
}

TEST_F(Downlink, IgnoresRobotsOfTheOtherMesh) {
  rig.command("nrf_5/cmd", hex("0a 00 ec ff"));
  rig.command("ble-0300/cmd", hex("0a 00 ec ff"));  // never heard
  rig.mesh.on_broker_message({"nr1", {"ntnu-slam/server/nr2/x", to_bytes("1")}}, rig.now);
  EXPECT_TRUE(outcomes().empty());
}

TEST_F(Downlink, ReportsCommandThatBoardDoesNotSend) {
  rig.board.status_of[0xab] = 0x83;
  rig.command("nr1/x", to_bytes("1"));
  rig.run_for(30s);
  ASSERT_EQ(outcomes().size(), 1u);
  EXPECT_NE(outcomes()[0].why.find("segmented"), std::string::npos);
}

TEST_F(Downlink, DoesNotSendCommandAfterItsOutcome) {
  rig.run_for(100ms);
  rig.board.is_silent = true;  // the link stays up while it synchronises
  rig.hear(0x0200, "ca 59 00");
  rig.command("nr1/x", to_bytes("1"));
  rig.run_for(3s);
  rig.stop();
  ASSERT_EQ(outcomes().size(), 1u);
  EXPECT_EQ(outcomes()[0].result, CommandResult::timeout);
  rig.board.is_silent = false;
  rig.run_for(20s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_TRUE(rig.sent_to(first_robot).empty());
}

TEST_F(Downlink, ForgetsAHandleThatTheBoardNoLongerKnows) {
  rig.hear(first_robot, "ca 59 00");
  rig.run_for(20ms);
  rig.board.addresses[*rig.board.handle_of(first_robot)].reset();
  rig.command("nr1/x", to_bytes("1"));
  rig.run_for(1s);
  EXPECT_EQ(rig.sent_to(first_robot).back(), "c5590031");
}

TEST_F(Downlink, RetainedCommandsReachARobotOnceEachTimeItComesOnline) {
  rig.command("nr1/x", to_bytes("1"), true);
  EXPECT_TRUE(sent().empty()) << "not online yet";
  for (std::size_t round = 1; round <= 2; ++round) {
    rig.hear(first_robot, "04 00 59 00");
    rig.command("nr1/x", to_bytes("1"), true);
    rig.command("nr1/x", to_bytes("1"), true);
    rig.run_for(20ms);
    rig.hear(first_robot, "c8 59 00 00");
    EXPECT_EQ(sent().size(), round);
    EXPECT_EQ(outcomes().size(), round);
    rig.run_for(31s);  // goes offline
  }
}

TEST_F(Downlink, RetainedCommandsWaitForTheLink) {
  rig.hear(first_robot, "04 00 59 00");
  rig.say(rig.board.restart());
  rig.command("nr1/x", to_bytes("1"), true);
  EXPECT_TRUE(outcomes().empty());
  const std::size_t before = rig.all<SubscribeRequest>().size();
  rig.run_for(1s);
  ASSERT_EQ(rig.all<SubscribeRequest>().size(), before + 1) << "makes the broker send it again";
  rig.command("nr1/x", to_bytes("1"), true);
  EXPECT_EQ(sent().size(), 1u);
}

TEST_F(Downlink, UsesTheApplicationKeyThatTheRobotUses) {
  rig.board.appkeys.emplace_back(std::uint16_t{1}, Bytes(16, 0x33));
  Bytes update = rig.board.message(first_robot, hex("cb 59 00 01"));
  update[6] = 1;  // application key handle
  rig.say(update);
  Bytes configuration = rig.board.message(first_robot, hex("80 03 00"));
  configuration[6] = 8;  // a device key
  rig.say(configuration);
  rig.command("nr1/x", to_bytes("1"));
  EXPECT_EQ(sent().size(), 1u);
  EXPECT_EQ(rig.board.sent.back().appkey_handle, 1);
}

TEST_F(Downlink, AnswersToRobotsOvertakeCommands) {
  rig.hear(first_robot, "ca 59 00");
  rig.run_for(20ms);
  rig.command("nr1/x", to_bytes("1"));  // in flight to the board
  rig.hear(0x0200, "04 00 59 00");
  rig.command("ble-0200/x", to_bytes("2"));
  rig.hear(first_robot, "ca 59 00");
  rig.run_for(100ms);
  ASSERT_EQ(rig.board.sent.size(), 4u);
  EXPECT_EQ(to_hex(rig.board.sent[2].payload), "cc590000");
  EXPECT_EQ(rig.board.sent[3].destination, 0x0200);
}

TEST_F(Downlink, GivingUpRobotReturnsItsWaitingCommands) {
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff");
  rig.command("nr1/run", to_bytes("stop"));
  rig.command("nr1/cmd", hex("01 00 02 00"), false, 2s);
  rig.command("nr1/x", to_bytes("hi"));
  rig.run_for(100ms);
  ASSERT_EQ(rig.sent_to(first_robot).size(), 1u);
  const auto waiting = rig.give_up("nr1");
  ASSERT_EQ(waiting.size(), 2u);
  EXPECT_EQ(waiting[0].command, CommandId{2});
  EXPECT_EQ(waiting[0].message.topic, "ntnu-slam/server/nr1/cmd");
  EXPECT_EQ(waiting[0].message.payload, hex("01 00 02 00"));
  EXPECT_EQ(waiting[0].message.qos, Qos::at_least_once);
  EXPECT_EQ(waiting[0].message.waited, 2100ms);
  EXPECT_EQ(waiting[1].command, CommandId{3});
  EXPECT_EQ(waiting[1].message.waited, 100ms);
  ASSERT_EQ(outcomes().size(), 1u) << "the robot may have carried it out";
  EXPECT_EQ(outcomes()[0].id, CommandId{1});
  EXPECT_EQ(outcomes()[0].result, CommandResult::timeout);
  EXPECT_EQ(outcomes()[0].why, "the robot moved to another gateway");
  EXPECT_TRUE(rig.mesh.open_commands().empty()) << "a restart does not find them";
  rig.run_for(40s);
  EXPECT_EQ(rig.sent_to(first_robot).size(), 1u);
  EXPECT_EQ(outcomes().size(), 1u);
}

/// The robot sends as before: other gateways do not hear this mesh.
TEST_F(Downlink, AnnouncesNoGivenUpRobotUntilItIsHeardAgain) {
  rig.hear(first_robot, "c9 59 00 0a 00 ec ff");
  EXPECT_EQ(rig.mesh.presence_of("nr1"), Presence::online);
  const std::uint64_t receipt = rig.all<Report>().at(0).receipt.id;
  rig.events.clear();
  EXPECT_TRUE(rig.give_up("nr1").empty());
  EXPECT_EQ(rig.mesh.presence_of("nr1"), Presence::offline);
  rig.receipt(receipt);
  EXPECT_EQ(sent().size(), 1u) << "no other gateway could acknowledge it";
  rig.run_for(40s);
  EXPECT_TRUE(rig.events.empty()) << "no presence, no will";
  rig.hear(first_robot, "04 00 59 00");
  ASSERT_EQ(rig.all<PresenceChange>().size(), 1u);
  EXPECT_EQ(rig.all<PresenceChange>()[0].presence, Presence::online);
  EXPECT_EQ(rig.asked().size(), 1u) << "the gateway wants its session";
  rig.command("nr1/x", to_bytes("1"), true);
  EXPECT_EQ(sent().size(), 2u) << "a retained command, once each time it comes";
}

TEST_F(Downlink, ReportsRetainedCommandsBeyondBound) {
  rig.hear(first_robot, "04 00 59 00");
  const auto retained = [&](std::size_t i) {
    rig.command("nr1/x" + std::to_string(i), to_bytes("1"), true);
  };
  for (std::size_t i = 0; i < ble::Downlink::max_retained; ++i) retained(i);
  EXPECT_EQ(rig.counter("retained_dropped"), 0u);
  EXPECT_TRUE(outcomes().empty()) << "all fit";
  const std::size_t notices = rig.all<Notice>().size();
  retained(100);
  retained(101);
  EXPECT_EQ(rig.counter("retained_dropped"), 2u);
  EXPECT_EQ(rig.all<Notice>().size(), notices + 1) << "once in a burst";
  retained(0);
  EXPECT_EQ(rig.counter("retained_dropped"), 2u) << "this one is known";
}

TEST_F(Downlink, TakingOverSessionOfAbsentRobotSubscribesOnce) {
  rig.hear(first_robot, "04 00 59 00");
  rig.give_up("nr1");
  rig.events.clear();
  rig.hold_session("nr1");  // its other gateway has died
  ASSERT_EQ(rig.all<SubscribeRequest>().size(), 1u);
  EXPECT_TRUE(rig.all<SubscribeRequest>()[0].is_standing);
  rig.hear(first_robot, "04 00 59 00");
  rig.events.clear();
  rig.hold_session("nr1");  // the broker was away
  EXPECT_TRUE(rig.events.empty());
}

TEST_F(Downlink, RefusesWaitingAndNewCommandsWhenGatewayStops) {
  rig.command("nr1/cmd", hex("0a 00 ec ff"));
  rig.command("nr1/run", to_bytes("stop"));
  rig.run_for(20ms);
  rig.stop();
  rig.command("nr1/x", to_bytes("too late"));
  ASSERT_EQ(outcomes().size(), 3u);
  for (const CommandOutcome& outcome : outcomes()) {
    EXPECT_EQ(outcome.result,
              outcome.type == "cmd" ? CommandResult::timeout : CommandResult::refused);
    EXPECT_EQ(outcome.why, "the gateway is stopping");
  }
  rig.hear(first_robot, "c5 59 00 68 69");  // to be acknowledged
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 1u);
  rig.receipt(reports[0].receipt.id);
  rig.run_for(20ms);
  EXPECT_EQ(rig.sent_to(first_robot).back(), "c8590000") << "robots are still answered";
}

}  // namespace
}  // namespace slamgw::ble
