// SPDX-License-Identifier: Apache-2.0
// A mesh that several gateways share: how a gateway treats robots whose sessions others hold.
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t group = 0xc010;
constexpr std::string_view update_set_numbered = "d2 59 00 07 0a 00 ec ff";

NodeDatabase shared_database() {
  NodeDatabase database = test_database();
  database.gateways = {2};
  Node node;
  node.uuid.fill(1);
  node.address = first_robot;
  node.state = NodeState::configured;
  database.nodes.push_back(node);
  return database;
}

Settings shared_settings() {
  Settings settings;
  settings.gateway_group = group;
  return settings;
}

class SharedMesh : public ::testing::Test {
 protected:
  explicit SharedMesh(NodeDatabase database = shared_database())
      : rig(shared_settings(), std::move(database)) {
    rig.mesh.ask_who_serves([this](const std::string&) { return is_holder; });
    rig.start();
  }

  std::vector<Report> reports() { return rig.all<Report>(); }
  std::size_t statuses() {
    rig.run_for(20ms);
    return rig.sent_to(first_robot).size();
  }
  void take_over() {
    is_holder = true;
    rig.hold_session("nr1");
  }
  std::vector<WaitingMessage> give_up() {
    is_holder = false;
    return rig.give_up("nr1");
  }

  bool is_holder = false;
  MeshRig rig;
};

TEST_F(SharedMesh, HearsTheGroupOfTheGateways) { EXPECT_TRUE(rig.board.handle_of(group)); }

TEST_F(SharedMesh, OnlyReportsHearingRobotOfAnotherGateway) {
  for (const std::string_view text :
       {update_set, update_set_numbered, std::string_view("cb 59 00 0a 00 ec ff"),
        std::string_view("ca 59 00")}) {
    rig.hear(first_robot, text, group);
    rig.run_for(1s);
  }
  EXPECT_TRUE(reports().empty());
  EXPECT_EQ(statuses(), 0u);
  EXPECT_TRUE(rig.all<PresenceChange>().empty());
  EXPECT_TRUE(rig.all<SignOfLife>().empty()) << "a sign of life would take over the session";
  EXPECT_TRUE(rig.asked().empty()) << "so would a subscription";
  EXPECT_EQ(rig.counter("left_to_others"), 4u);
  ASSERT_EQ(rig.heard.size(), 4u);
  EXPECT_EQ(rig.heard[0].robot, "nr1");
  ASSERT_TRUE(rig.heard[0].radio);
  EXPECT_LT(rig.heard[0].radio->rssi_dbm, 0);
}

TEST_F(SharedMesh, PublishesAndAcknowledgesWithSession) {
  take_over();
  rig.hear(first_robot, update_set, group);
  ASSERT_EQ(reports().size(), 1u);
  rig.receipt(reports()[0].receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

/// A late STATUS could acknowledge the robot's next message, which only the other gateway has.
TEST_F(SharedMesh, DoesNotAcknowledgeAfterGivingUpSession) {
  take_over();
  rig.hear(first_robot, update_set, group);
  give_up();
  rig.receipt(reports().at(0).receipt.id);
  EXPECT_EQ(statuses(), 0u);
}

/// The gateway has lost the session and does not know the new holder yet.
TEST_F(SharedMesh, DoesNotAcknowledgeWithoutSession) {
  take_over();
  rig.hear(first_robot, update_set, group);
  is_holder = false;
  rig.receipt(reports().at(0).receipt.id);
  EXPECT_EQ(statuses(), 0u);
  is_holder = true;
  rig.run_for(280ms);
  rig.hear(first_robot, update_set, group);
  EXPECT_EQ(reports().size(), 2u) << "the repeat is published";
  rig.receipt(reports().at(1).receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

/// Another gateway may command the robot: no repeat may overtake its commands.
TEST_F(SharedMesh, DoesNotSendOrRepeatCommandsWithoutSession) {
  take_over();
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff", group);
  rig.run_for(1s);
  const std::size_t before = rig.sent_to(first_robot).size();
  rig.command("nr1/run", {1});
  rig.run_for(20ms);
  const std::size_t sent = rig.sent_to(first_robot).size();
  EXPECT_EQ(sent, before + 1);
  rig.command("nr1/cmd", {10, 0, 20, 0});
  is_holder = false;
  rig.run_for(20s);
  EXPECT_EQ(rig.sent_to(first_robot).size(), sent);
  rig.run_for(20s);
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 2u);
  for (const CommandOutcome& outcome : outcomes) EXPECT_EQ(outcome.result, CommandResult::timeout);
}

TEST_F(SharedMesh, SendsWaitingCommandWhenSessionReturns) {
  take_over();
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff", group);
  is_holder = false;
  rig.command("nr1/run", {1});
  EXPECT_EQ(statuses(), 0u);
  take_over();
  EXPECT_EQ(statuses(), 1u);
}

TEST_F(SharedMesh, SendsRetainedCommandOnlyWithSession) {
  rig.hear(first_robot, update_set, group);
  rig.command("nr1/run", {1}, true);
  rig.run_for(1s);
  EXPECT_TRUE(rig.sent_to(first_robot).empty());
  take_over();
  EXPECT_EQ(rig.asked().size(), 1u) << "the broker sends it again";
  rig.command("nr1/run", {1}, true);
  EXPECT_EQ(statuses(), 1u);
  give_up();
  rig.run_for(20s);
  take_over();
  EXPECT_EQ(rig.asked().size(), 1u) << "the robot has had it";
  EXPECT_TRUE(rig.all<SubscribeRequest>().back().is_standing);
}

/// The robot stands still: an equal update is a new message, which another gateway may not have
/// heard.
TEST_F(SharedMesh, EqualUpdateAfterSessionMovedIsNew) {
  for (const std::string_view text : {update_set, update_set_numbered}) {
    take_over();
    const std::size_t before = reports().size();
    rig.hear(first_robot, text, group);
    rig.receipt(reports().back().receipt.id);
    give_up();
    rig.run_for(10s);
    take_over();
    rig.hear(first_robot, text, group);
    EXPECT_EQ(reports().size(), before + 2);
    is_holder = false;
    rig.run_for(10s);
    rig.hear(first_robot, text, group);  // for another gateway
    is_holder = true;
    rig.run_for(280ms);
    rig.hear(first_robot, text, group);
    EXPECT_EQ(reports().size(), before + 3);
    give_up();
  }
}

/// The session's holder has died: the message is published without another repeat.
TEST_F(SharedMesh, PublishesUnansweredMessageAtTakeover) {
  for (const int copies : {1, 2}) {
    for (int i = 0; i < copies; ++i) {
      rig.run_for(280ms);
      rig.hear(first_robot, update_set, group);
    }
    rig.run_for(100ms);
    take_over();
    ASSERT_EQ(reports().size(), copies - 1u) << "a first copy may have been answered";
    if (copies == 1) give_up();
    rig.run_for(5s);
  }
  rig.receipt(reports().at(0).receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

TEST_F(SharedMesh, PublishesNoMessageAtTakeoverThatIsNoLongerRepeated) {
  rig.hear(first_robot, update_set, group);
  rig.run_for(280ms);
  rig.hear(first_robot, update_set, group);
  rig.run_for(1s);  // the next copy would have come
  take_over();
  EXPECT_TRUE(reports().empty());
}

/// Later copies fit the schedule of the first one, which no gateway answered.
TEST_F(SharedMesh, RecognizesRepeatOfMessagePublishedAtTakeover) {
  const TimePoint first = rig.now;
  for (const int iv : {0, 1, 2}) {
    rig.run_for(first + 280ms * iv - rig.now);
    rig.hear(first_robot, "c5 59 00 01", group);
  }
  take_over();
  ASSERT_EQ(reports().size(), 1u);
  rig.receipt(reports()[0].receipt.id);
  rig.run_for(first + 280ms * 4 - rig.now);  // STATUS was lost
  rig.hear(first_robot, "c5 59 00 01", group);
  EXPECT_EQ(statuses(), 2u);
}

/// The broker was away for a moment, and no other gateway has served the robot.
TEST_F(SharedMesh, AcknowledgesPublishedMessageWhenSessionReturns) {
  take_over();
  rig.hear(first_robot, "c5 59 00 01", group);
  rig.hold_session("nr1");
  rig.receipt(reports().at(0).receipt.id);
  EXPECT_EQ(statuses(), 1u);
  rig.run_for(260ms);
  rig.hear(first_robot, "c5 59 00 01", group);
  EXPECT_EQ(reports().size(), 1u);
}

TEST_F(SharedMesh, GivingUpEndsSentCommandsAndReturnsWaitingOnes) {
  take_over();
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff", group);
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.command("nr1/x", to_bytes("1"));
  rig.run_for(10ms);
  EXPECT_EQ(rig.sent_to(first_robot).size(), 1u);
  EXPECT_EQ(give_up().size(), 1u);
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::timeout);
  rig.run_for(10s);
  EXPECT_EQ(rig.sent_to(first_robot).size(), 1u)
      << "no repeat overtakes the other gateway's commands";
}

TEST_F(SharedMesh, TakeoverReportsHeardRobotOnline) {
  for (std::size_t round = 1; round <= 2; ++round) {
    rig.hear(first_robot, update_set, group);
    take_over();
    const auto changes = rig.all<PresenceChange>();
    ASSERT_EQ(changes.size(), round);
    EXPECT_EQ(changes.back().presence, Presence::online);
    EXPECT_EQ(rig.mesh.presence_of("nr1"), Presence::online);
    give_up();
    EXPECT_EQ(rig.mesh.presence_of("nr1"), Presence::offline);
    rig.run_for(40s);
    EXPECT_EQ(rig.all<PresenceChange>().size(), round) << "the other gateway reports its silence";
  }
}

/// No gateway has heard the robot for a while: its last gateway has died.
TEST_F(SharedMesh, TakeoverReportsSilentRobotOffline) {
  rig.run_for(40s);
  EXPECT_TRUE(rig.all<PresenceChange>().empty()) << "another gateway may hear it";
  take_over();
  rig.run_for(40s);
  ASSERT_EQ(rig.all<PresenceChange>().size(), 1u);
  EXPECT_EQ(rig.all<PresenceChange>()[0].presence, Presence::offline);
  rig.hear(first_robot, update_set, group);
  EXPECT_EQ(rig.all<PresenceChange>().size(), 2u);
  EXPECT_EQ(rig.asked().size(), 1u);
}

struct Alone : SharedMesh {
  Alone() : SharedMesh(test_database()) {}
};

TEST_F(Alone, ServesRobotsWithoutAskingForSession) {
  rig.hear(first_robot, update_set, group);
  EXPECT_EQ(reports().size(), 1u);
  EXPECT_TRUE(rig.heard.empty());
  rig.receipt(reports()[0].receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

}  // namespace
}  // namespace slamgw::ble
