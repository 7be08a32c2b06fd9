// SPDX-License-Identifier: Apache-2.0
// Reports for the robots' sessions at the broker: notes for other gateways, clean starts and signs
// of life.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

TEST(Notes, DescribeAKeptSessionOnce) {
  ConnectedRig rig(false);
  rig.register_topic(1, own_topic);
  rig.subscribe(1, "a/x", 1);
  EXPECT_TRUE(rig.notes.empty()) << "both changes are in one note";
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 1U);
  EXPECT_EQ(rig.notes[0].robot, "r1");
  const auto note = decode_session(rig.notes[0].note);
  ASSERT_TRUE(note);
  EXPECT_EQ(note->client_id, "r1");
  EXPECT_EQ(note->keep_alive, std::chrono::seconds(60));
  EXPECT_EQ(note->topics.size(), 2U);
  EXPECT_EQ(note->subscriptions.size(), 1U);
  EXPECT_FALSE(note->peer);
}

TEST(Notes, ArePublishedAgainWhenTheBrokerSessionOpens) {
  ConnectedRig rig(false);
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 1U);
  rig.gateway.on_session_held("r1");
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 2U) << "the first note may have been lost";
  EXPECT_EQ(rig.notes[1].note, rig.notes[0].note);
  rig.connect(2, "r2");
  rig.gateway.on_session_held("r2");
  rig.pass_s(2);
  EXPECT_EQ(rig.notes.size(), 2U) << "a clean session without topics has no note";
}

TEST(Notes, AreNotRewrittenForMessagesStatesOrAddresses) {
  ConnectedRig rig(false);
  const auto id = rig.register_topic(1, own_topic);
  rig.subscribe(1, "a/#", 2);
  rig.pass_s(2);
  rig.notes.clear();

  rig.broker("a/x", "hi", 1);
  rig.publish(1, id, 2, 7);
  rig.sleep(1);
  rig.pass_s(5);
  rig.send(1, Pingreq{"r1"});
  rig.send(2, Connect{false, false, protocol_id, 60, "r1"});
  rig.pass_s(5);
  EXPECT_TRUE(rig.notes.empty()) << "messages, states and addresses are not in notes";

  rig.send(2, Unsubscribe{TopicIdType::normal, 9, "a/#", 0});
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 1U);
  EXPECT_TRUE(decode_session(rig.notes[0].note)->subscriptions.empty());
}

/// A robot may go to its next gateway just after it has subscribed, or unsubscribed.
TEST(Notes, AreWrittenAtOnce) {
  ConnectedRig rig(false);
  rig.pass_s(2);
  rig.notes.clear();
  rig.subscribe(1, "a/x", 1);
  rig.pass({});
  ASSERT_EQ(rig.notes.size(), 1U);
  EXPECT_EQ(decode_session(rig.notes[0].note)->subscriptions.size(), 1U);
}

/// A CONNECT without CleanSession resumes a clean session that still goes on (R36), also at another
/// gateway.
TEST(Notes, DescribeACleanSessionUntilItEnds) {
  ConnectedRig rig;
  rig.pass_s(2);
  EXPECT_TRUE(rig.notes.empty()) << "there is nothing to continue";
  rig.subscribe(1, "a/x", 1);
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 1U);
  EXPECT_EQ(decode_session(rig.notes[0].note)->subscriptions.size(), 1U);
  rig.connect(1, "r1", false);
  rig.pass_s(2);
  EXPECT_EQ(rig.notes.size(), 1U) << "its content is the same";
  rig.connect(1, "r1", true);
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 2U);
  EXPECT_TRUE(rig.notes[1].note.empty());
  rig.subscribe(1, "a/x", 1);
  rig.pass_s(2);
  rig.send(1, Disconnect{});
  rig.pass_s(5);
  ASSERT_EQ(rig.notes.size(), 4U);
  EXPECT_TRUE(rig.notes[3].note.empty());
}

TEST(Notes, NameATopicOfTheGatewayOnceTheRobotPublishesToIt) {
  ConnectedRig rig(false);
  rig.subscribe(1, "a/#", 0);
  rig.broker("a/x");
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  rig.pass_s(2);
  rig.notes.clear();
  rig.publish(1, 1, 0, 0);
  rig.pass({});
  ASSERT_EQ(rig.notes.size(), 1U);
  EXPECT_EQ(decode_session(rig.notes[0].note)->topics.size(), 1U);
}

TEST(Notes, AreWithdrawnWithTheSession) {
  Settings settings;
  settings.max_clients = 1;
  SnRig rig(settings);
  rig.connect(1, "r1", false);
  rig.pass_s(2);
  rig.send(1, Disconnect{});
  rig.pass(std::chrono::hours(25));
  rig.notes.clear();
  rig.connect(2, "r2");
  ASSERT_EQ(rig.notes.size(), 1U);
  EXPECT_EQ(rig.notes[0].robot, "r1");
  EXPECT_TRUE(rig.notes[0].note.empty());
}

TEST(Notes, MoveToTheNewNameOfARenamedRobot) {
  ConnectedRig rig(false);
  rig.pass_s(2);
  rig.notes.clear();
  rig.rename({{"tank", {}, "r1"}});
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 2U);
  EXPECT_EQ(rig.notes[0].robot, "r1");
  EXPECT_TRUE(rig.notes[0].note.empty());
  EXPECT_EQ(rig.notes[1].robot, "tank");
  EXPECT_FALSE(rig.notes[1].note.empty());
}

/// Another gateway may have written a newer note during the restart.
TEST(Notes, AreNotWrittenAgainAfterARestart) {
  ConnectedRig before(false);
  before.subscribe(1, "a/x", 1);
  SnRig after;
  ASSERT_TRUE(after.gateway.restore(*before.gateway.snapshot("r1", before.now), after.now));
  after.pass_s(5);
  EXPECT_TRUE(after.notes.empty());
  after.subscribe(1, "a/y", 1);
  after.pass_s(2);
  EXPECT_EQ(after.notes.size(), 1U);
}

TEST(Notes, AreNotWrittenAgainByTheGatewayThatReadThem) {
  ConnectedRig before(false);
  before.subscribe(1, "a/x", 1);
  before.pass_s(2);
  SnRig next;
  next.gateway.ask_where_served([](const std::string&) { return true; });
  next.connect(1, "r1", false);
  next.note("r1", before.notes.at(0).note);
  next.pass_s(5);
  EXPECT_TRUE(next.notes.empty());
}

TEST(Notes, AreNotWrittenBeyondTheirSizeLimit) {
  ConnectedRig rig(false, 6000);
  std::string topic = "a/" + std::string(1000, 'x');
  for (std::size_t i = 0; i < limits::max_note_octets / 1000 + 1; ++i)
    rig.register_topic(1, topic + std::to_string(i));
  rig.pass_s(5);
  EXPECT_TRUE(rig.notes.empty());
}

/// The robot's next gateway must not take old subscriptions for its present ones.
TEST(Notes, AreWithdrawnWhenTheSessionOutgrowsTheBound) {
  ConnectedRig rig(false, 6000);
  rig.pass_s(2);
  ASSERT_EQ(rig.notes.size(), 1U);
  std::string topic = "a/" + std::string(1000, 'x');
  for (std::size_t i = 0; i < limits::max_note_octets / 1000 + 1; ++i)
    rig.register_topic(1, topic + std::to_string(i));
  rig.pass_s(5);
  ASSERT_EQ(rig.notes.size(), 2U);
  EXPECT_TRUE(rig.notes[1].note.empty());
}

TEST(Notes, AreWrittenForManyRobotsWithinTwoSeconds) {
  SnRig rig;
  for (unsigned n = 0; n < 200; ++n) rig.connect(n, "r" + std::to_string(n), false);
  rig.pass_s(2);
  EXPECT_EQ(rig.notes.size(), 200U);
}

TEST(SnGateway, ReportsACleanStartBeforeTheNewSubscriptions) {
  ConnectedRig rig(false);
  rig.subscribe(1, "a/x");
  EXPECT_TRUE(rig.cleaned.empty());
  rig.connect(1, "r1", true);
  ASSERT_EQ(rig.cleaned.size(), 1U);
  EXPECT_EQ(rig.cleaned[0].robot, "r1");
  EXPECT_TRUE(rig.filters["r1"].empty());
  rig.subscribe(1, "a/y");
  EXPECT_EQ(rig.filters["r1"], std::set<std::string>{"a/y"});
  rig.connect(2, "r2", true);
  EXPECT_EQ(rig.cleaned.size(), 2U) << "the broker may have a session of another gateway";
  rig.send(3, Connect{true, true, protocol_id, 60, "r3"});
  EXPECT_EQ(rig.cleaned.size(), 2U) << "the CONNECT is not accepted yet";
}

TEST(SnGateway, DoesNotCountAConnectAsASignOfLife) {
  for (const bool is_clean : {true, false}) {
    SnRig rig;
    for (int i = 0; i < 3; ++i) {
      rig.connect(1, "r1", is_clean);
      rig.pass_s(2);
    }
    rig.pass_s(60);
    rig.connect(1, "r1", is_clean);
    EXPECT_EQ(rig.signs_of_life, 0U);
    EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
    rig.send(1, Pingreq{});
    EXPECT_EQ(rig.signs_of_life, 1U);
  }
}

}  // namespace
}  // namespace slamgw::mqttsn
