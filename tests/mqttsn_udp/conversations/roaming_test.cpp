// SPDX-License-Identifier: Apache-2.0
// Robots that move to this gateway, and robots that move to another one.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// A gateway that takes r1 to be served by another gateway.
struct Next : SnRig {
  explicit Next(Settings settings = {}, RandomSource random = {})
      : SnRig(std::move(settings), {}, {"w/#", "a/#", "ab"}, {"w/#", "a/#", "ab"},
              std::move(random)) {
    gateway.ask_where_served([](const std::string& robot) { return robot == "r1"; });
  }
  void robot_comes() { send(1, Connect{false, false, protocol_id, 60, "r1"}); }
};

/// Returns the note about a robot with a will, a topic and a subscription by predefined id.
Bytes note_of_r1() {
  Settings settings;
  settings.predefined_topics = {{7, r1_command, "r1"}};
  SnRig rig(settings);
  rig.send(1, Connect{true, false, 1, 60, "r1"});
  rig.send(1, WillTopic{WireQos::one, true, "ntnu-slam/robot/r1/gone"});
  rig.send(1, WillMsg{to_bytes("bye")});
  rig.register_topic(1, own_topic);
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::predefined, 9, "", 7});
  rig.pass_s(2);
  return rig.notes.back().note;
}

SessionSnapshot read(const Bytes& note) { return decode_session(note).value(); }

TEST(Roaming, ResumesASessionFromTheNoteOfAnotherGateway) {
  Next rig;
  rig.robot_comes();
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.signs_of_life, 0U);
  ASSERT_EQ(rig.note_requests.size(), 1U);
  EXPECT_EQ(rig.note_requests[0].robot, "r1");
  rig.robot_comes();
  EXPECT_EQ(rig.note_requests.size(), 1U) << "a repeated CONNECT asks no second time";

  rig.note("r1", note_of_r1());
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
  EXPECT_TRUE(rig.cleaned.empty());
  ASSERT_EQ(rig.subscribes.size(), 1U);
  EXPECT_EQ(rig.subscribes[0].filter, r1_command);
  EXPECT_TRUE(rig.subscribes[0].is_standing);
  rig.broker(r1_command, "go", 1);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 predefined id=7 msg=1 data=676f");
  rig.publish(1, 1, 0, 0);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, own_topic) << "its topic ids keep their meaning";
  rig.pass_s(100);
  EXPECT_TRUE(rig.reports.back().is_will);
}

/// Otherwise the robot could take a command for a repeat from its former gateway.
TEST(Roaming, StartsMessageIdsAtARandomNumber) {
  Next rig({}, [] { return std::uint16_t{0x4000}; });
  rig.robot_comes();
  rig.note("r1", note_of_r1());
  rig.broker(r1_command, "go", 1);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 predefined id=7 msg=16385 data=676f");
}

TEST(Roaming, ResumesASessionInThePlaceOfALostClient) {
  for (const bool is_lost : {true, false}) {
    Settings settings;
    settings.max_clients = 1;
    Next rig(settings);
    rig.connect(9, "r9");
    rig.subscribe(9, "a/x");
    if (is_lost) rig.pass_s(100);
    rig.robot_comes();
    rig.note("r1", note_of_r1());
    EXPECT_EQ(rig.sent_to(1), is_lost ? Lines{"CONNACK code=0"} : Lines{});
    rig.publish(1, 1, 0, 0);
    EXPECT_EQ(rig.reports.size(), is_lost ? 1U : 0U);
    rig.pass_s(3);
    for (const NoteChanged& note : rig.notes)
      EXPECT_TRUE(note.robot == "r9" || read(note.note).will) << "the note of r1 keeps its will";
  }
}

TEST(Roaming, KeepsARobotsPlaceDuringItsWillHandshake) {
  Settings settings;
  settings.max_clients = 1;
  Next rig(settings);
  rig.send(1, Connect{true, false, protocol_id, 60, "r1"});
  rig.note("r1", note_of_r1());
  rig.send(2, Connect{false, true, protocol_id, 60, "r2"});
  rig.send(1, WillTopic{WireQos::one, true, "ntnu-slam/robot/r1/gone"});
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.publish(1, 1, 0, 0);
  EXPECT_EQ(rig.reports.size(), 1U) << "its topic ids keep their meaning";
  rig.pass_s(3);
  for (const NoteChanged& note : rig.notes) EXPECT_FALSE(note.note.empty());
}

TEST(Roaming, AcceptsARobotWithoutANoteAfterTwoSeconds) {
  for (const bool is_answered : {true, false}) {
    Next rig;
    rig.robot_comes();
    rig.pass(milliseconds(1999));
    EXPECT_TRUE(rig.is_silent(1));
    if (is_answered) rig.note("r1", ByteView());
    rig.pass(milliseconds(1));
    EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
    EXPECT_TRUE(rig.cleaned.empty()) << "the broker keeps its subscriptions";
    rig.note("r1", note_of_r1());
    EXPECT_EQ(rig.subscribes.empty(), is_answered) << "a late note completes the session";
  }
}

/// The robot has moved while the broker was away.
TEST(Roaming, CompletesASessionFromANoteThatCouldNotBeRead) {
  Next rig;
  rig.robot_comes();
  rig.note("r1", std::nullopt);
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
  rig.subscribe(1, "a/x", 1);
  rig.pass_s(5);
  EXPECT_TRUE(rig.notes.empty()) << "the former gateway's note holds more";
  EXPECT_EQ(rig.note_requests.size(), 1U);
  rig.session_held("r1");
  EXPECT_EQ(rig.note_requests.size(), 2U);
  rig.subscribes.clear();
  rig.note("r1", note_of_r1());
  EXPECT_EQ(rig.filters["r1"], (std::set<std::string>{"a/x", r1_command}));
  for (const SubscribeRequest& each : rig.subscribes) EXPECT_TRUE(each.is_standing);
  rig.publish(1, 1, 0, 0);
  ASSERT_EQ(rig.reports.size(), 1U) << "its topic ids keep their meaning";
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 1U);
  const SessionSnapshot merged = read(rig.notes[0].note);
  EXPECT_EQ(merged.subscriptions.size(), 2U);
  EXPECT_TRUE(merged.will);
  rig.session_held("r1");
  EXPECT_EQ(rig.note_requests.size(), 2U) << "nothing is missing any more";
}

TEST(Roaming, RestoresNoFilterFromALateNoteThatTheRobotHasGivenUp) {
  Next rig;
  rig.robot_comes();
  rig.note("r1", std::nullopt);
  rig.send(1, Unsubscribe{TopicIdType::normal, 3, r1_command, 0});
  rig.session_held("r1");
  rig.note("r1", note_of_r1());
  EXPECT_TRUE(rig.filters["r1"].empty());
}

TEST(Roaming, WritesANoteWhenTheFormerGatewayHasLeftNone) {
  for (const bool is_clean : {true, false}) {
    Next rig;
    rig.robot_comes();
    rig.note("r1", std::nullopt);
    if (is_clean) rig.connect(1, "r1", true);
    rig.subscribe(1, "a/x", 1);
    rig.session_held("r1");
    EXPECT_EQ(rig.note_requests.size(), is_clean ? 1U : 2U);
    rig.note("r1", ByteView());
    rig.pass_s(2);
    EXPECT_EQ(rig.notes.size(), 1U);
  }
}

TEST(Roaming, DelaysOnlyConnectsThatResumeAnotherGatewaysSession) {
  Next rig;
  rig.connect(1, "r1", true);
  rig.connect(1, "r1", false);
  rig.connect(2, "r2", false);
  EXPECT_EQ(rig.gateway.presence_of("r2"), Presence::online);
  EXPECT_TRUE(rig.note_requests.empty());
}

TEST(Roaming, StartsACleanSessionIfASecondConnectAsksForOne) {
  Next rig;
  rig.robot_comes();
  rig.send(1, Connect{false, true, protocol_id, 60, "r1"});
  rig.note("r1", note_of_r1());
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
  EXPECT_EQ(rig.cleaned.size(), 1U);
  EXPECT_TRUE(rig.filters["r1"].empty());
  rig.pass_s(100);
  EXPECT_TRUE(rig.reports.empty()) << "the former session's will is gone";
}

/// The robot has moved or restarted while its first CONNECT waits.
TEST(Roaming, AnswersOnlyTheLastConnectOfARobot) {
  for (const bool is_clean : {true, false}) {
    Next rig;
    rig.robot_comes();
    rig.send(2, Connect{false, is_clean, protocol_id, 60, "r1"});
    rig.note("r1", note_of_r1());
    rig.pass_s(5);
    EXPECT_TRUE(rig.is_silent(1));
    EXPECT_EQ(rig.sent_to(2), Lines{"CONNACK code=0"});
    EXPECT_EQ(rig.note_requests.size(), 1U);
    EXPECT_EQ(rig.cleaned.size(), is_clean ? 1U : 0U);
    rig.send(2, Pingreq{});
    EXPECT_EQ(rig.last_to(2), "PINGRESP");
  }
}

/// The broker sends waiting messages as soon as the session is open, before the note is read.
TEST(Roaming, DeliversEarlyCommandsAfterTheConnack) {
  Next rig;
  rig.robot_comes();
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  rig.robot_message({"r1", {r1_command, to_bytes("go"), Qos::at_least_once}, CommandId{5}});
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_TRUE(rig.outcomes.empty());
  rig.pass_s(1);
  rig.note("r1", note_of_r1());
  EXPECT_EQ(
      rig.sent_to(1),
      (Lines{"CONNACK code=0", "PUBLISH dup=0 qos=1 retain=0 predefined id=7 msg=1 data=676f"}));
  rig.send(1, Puback{7, 1, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].id, CommandId{5});
  EXPECT_EQ(rig.outcomes[0].after, seconds(1));
}

TEST(Roaming, DeliversEarlyCommandsAfterTheWillHandshake) {
  Next rig;
  rig.send(1, Connect{true, false, protocol_id, 60, "r1"});
  rig.robot_message({"r1", {r1_command, to_bytes("go"), Qos::at_least_once}, CommandId{5}});
  rig.note("r1", ByteView());
  EXPECT_EQ(rig.sent_to(1), Lines{"WILLTOPICREQ"});
  rig.send(1, WillTopic{WireQos::one, true, "ntnu-slam/robot/r1/gone"});
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=" + r1_command);
  EXPECT_TRUE(rig.outcomes.empty());
}

/// A client with write access at the broker can forge a note.
TEST(Roaming, TakesNoMessagesFromANote) {
  SessionSnapshot forged = read(note_of_r1());
  MessageSnapshot run;
  run.message = {r1_command, to_bytes("run"), Qos::at_least_once};
  forged.messages = {run};
  forged.released = {4};
  forged.repeats = {{1, 1, 1, milliseconds(1)}};
  forged.inbound_qos2 = {{1, 1}};
  forged.state = ClientState::active;
  Next rig;
  rig.robot_comes();
  rig.note("r1", encode_session(forged));
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
}

TEST(Roaming, TakesNoForbiddenWillOrSubscriptionFromANote) {
  const SessionSnapshot note = read(note_of_r1());
  for (const std::string topic : {"ntnu-slam/robot/r2/gone", "elsewhere", "a/#", ""}) {
    SessionSnapshot forged = note;
    forged.will->topic = topic;
    forged.subscriptions = {{"ntnu-slam/server/r2/cmd"}, {"a+"}};
    Next rig;
    rig.robot_comes();
    rig.note("r1", encode_session(forged));
    EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
    EXPECT_TRUE(rig.subscribes.empty());
    rig.pass_s(100);
    EXPECT_TRUE(rig.reports.empty()) << "no will on " << topic;
  }
}

TEST(Roaming, IgnoresInvalidNotesAndNotesAboutOtherClients) {
  const Bytes note = note_of_r1();
  SessionSnapshot other_robot = read(note);
  other_robot.robot = "r2";
  SessionSnapshot other_client = read(note);
  other_client.client_id = "r2";
  for (const Bytes& bad : {encode_session(other_robot), encode_session(other_client),
                           to_bytes("junk"), Bytes(limits::max_note_octets + 1, 0)}) {
    Next rig;
    rig.robot_comes();
    rig.note("r1", bad);
    EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
    EXPECT_TRUE(rig.subscribes.empty());
    EXPECT_FALSE(rig.gateway.snapshot("r2", rig.now));
  }
}

TEST(Roaming, BoundsTheSubscriptionsFromANote) {
  SessionSnapshot forged = read(note_of_r1());
  for (int i = 0; i < 1000; ++i) forged.subscriptions.push_back({"a/" + std::to_string(i)});
  Next rig;
  rig.robot_comes();
  rig.note("r1", encode_session(forged));
  EXPECT_EQ(rig.filters["r1"].size(), limits::max_subscriptions_per_client);
}

TEST(Roaming, HandsOnUnsentMessagesOfARobotThatMovedAway) {
  SnRig rig;
  rig.send(1, Connect{true, false, 1, 60, "r1"});
  rig.send(1, WillTopic{WireQos::one, true, "ntnu-slam/robot/r1/gone"});
  rig.send(1, WillMsg{to_bytes("bye")});
  rig.subscribe(1, r1_command, 1);
  rig.subscribe(1, "a/x", 0);
  rig.pass_s(2);
  rig.broker(r1_command, "on the air", 1);
  rig.broker(r1_command, "waits", 1);
  rig.broker("a/x", "waits at QoS 0", 0);
  rig.pass_s(1);
  rig.presence.clear();
  rig.notes.clear();
  (void)rig.gateway.take_changed(1000);

  const auto unsent = rig.give_up("r1");
  ASSERT_EQ(unsent.size(), 2U);
  EXPECT_EQ(as_text(unsent[0].message.payload), "waits");
  EXPECT_EQ(unsent[0].command, CommandId{2});
  EXPECT_EQ(unsent[0].message.waited, seconds(1));
  EXPECT_EQ(as_text(unsent[1].message.payload), "waits at QoS 0");
  EXPECT_EQ(unsent[1].command, CommandId::none);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].id, CommandId{1});
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout);
  EXPECT_EQ(rig.outcomes[0].why, "the robot moved to another gateway");

  rig.pass_s(200);
  EXPECT_EQ(rig.outcomes.size(), 1U) << "the other gateway reports the unsent command";
  EXPECT_TRUE(rig.reports.empty()) << "the will is not published";
  EXPECT_TRUE(rig.presence.empty());
  EXPECT_TRUE(rig.unsubscribes.empty()) << "the other gateway holds the session";
  EXPECT_TRUE(rig.cleaned.empty());
  EXPECT_TRUE(rig.notes.empty());
  EXPECT_EQ(rig.gateway.presence_of("r1"), std::nullopt);
  EXPECT_EQ(rig.gateway.take_changed(1000), Lines{"r1"}) << "the store deletes the session";
  EXPECT_FALSE(rig.gateway.snapshot("r1", rig.now));
}

/// The robot has forgotten the topic id, so the command waits for another REGISTER.
TEST(Roaming, HandsOnNoCommandThatWasReportedAsSent) {
  SnRig rig;
  rig.connect(1, "r1");
  rig.subscribe(1, r1_command, 0);
  rig.broker(r1_command, "go", 0);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::sent);
  rig.send(1, Puback{1, 0, ReturnCode::invalid_topic_id});
  ASSERT_EQ(rig.gateway.queued_for("r1"), 1U);
  EXPECT_TRUE(rig.give_up("r1").empty());
  EXPECT_EQ(rig.outcomes.size(), 1U);
}

TEST(Roaming, HandsOnAllCommandsOfARobotWhoseConnectWaits) {
  Next rig;
  rig.robot_comes();
  rig.robot_message({"r1", {r1_command, to_bytes("go"), Qos::at_most_once}, CommandId{5}});
  rig.pass_s(1);
  const auto unsent = rig.give_up("r1");
  ASSERT_EQ(unsent.size(), 1U);
  EXPECT_EQ(unsent[0].command, CommandId{5});
  EXPECT_EQ(unsent[0].message.waited, seconds(1));
  rig.pass_s(5);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_TRUE(rig.give_up("r1").empty());
}

TEST(Roaming, RefusesCommandsOfAWaitingConnectAtShutdown) {
  Next rig;
  rig.robot_comes();
  rig.robot_message({"r1", {r1_command, to_bytes("go"), Qos::at_least_once}, CommandId{5}});
  rig.pass_s(1);
  rig.stop();
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].id, CommandId{5});
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::refused);
  EXPECT_EQ(rig.outcomes[0].after, seconds(1));
  rig.robot_message({"r1", {r1_command, to_bytes("late"), Qos::at_least_once}, CommandId{6}});
  ASSERT_EQ(rig.outcomes.size(), 2U);
  EXPECT_EQ(rig.outcomes[1].id, CommandId{6});
  rig.note("r1", note_of_r1());
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"}) << "the refused command is not sent";
}

TEST(Roaming, HandsOnCommandsOfASleeper) {
  ConnectedRig rig(false);
  rig.subscribe(1, r1_command, 1);
  rig.sleep(1);
  rig.broker(r1_command, "go", 1);
  rig.pass_s(10);
  const auto unsent = rig.give_up("r1");
  ASSERT_EQ(unsent.size(), 1U);
  EXPECT_EQ(unsent[0].message.waited, seconds(10));
  EXPECT_TRUE(rig.outcomes.empty());
}

}  // namespace
}  // namespace slamgw::mqttsn
