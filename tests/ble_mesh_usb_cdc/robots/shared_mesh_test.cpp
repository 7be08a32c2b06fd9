// SPDX-License-Identifier: Apache-2.0
// A mesh that several gateways share: what a gateway does with robots that another one serves.
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
    rig.mesh.ask_who_serves([this](const std::string&) { return is_owner; });
    rig.start();
  }

  std::vector<Report> reports() { return rig.all<Report>(); }
  std::size_t statuses() {
    rig.run_for(20ms);
    return rig.sent_to(first_robot).size();
  }
  void take_over() {
    is_owner = true;
    rig.mesh.on_taken_over("nr1", rig.now);
    rig.run_for(0ms);
  }
  void give_up() {
    is_owner = false;
    rig.mesh.on_given_up("nr1", rig.now);
    rig.run_for(0ms);
  }

  bool is_owner = false;
  MeshRig rig;
};

TEST_F(SharedMesh, HearsTheGroupOfTheGateways) { EXPECT_TRUE(rig.board.handle_of(group)); }

TEST_F(SharedMesh, ARobotOfAnotherGatewayIsHeardAndNothingElse) {
  for (const std::string_view text :
       {update_set, update_set_numbered, std::string_view("cb 59 00 0a 00 ec ff"),
        std::string_view("ca 59 00")}) {
    rig.hear(first_robot, text, group);
    rig.run_for(1s);
  }
  EXPECT_TRUE(reports().empty());
  EXPECT_EQ(statuses(), 0u);
  EXPECT_EQ(rig.counter("left_to_others"), 4u);
  ASSERT_EQ(rig.heard.size(), 4u);
  EXPECT_EQ(rig.heard[0].robot, "nr1");
  ASSERT_TRUE(rig.heard[0].radio);
  EXPECT_LT(rig.heard[0].radio->rssi_dbm, 0);
}

TEST_F(SharedMesh, ItsOwnerReportsAndAnswers) {
  take_over();
  rig.hear(first_robot, update_set, group);
  ASSERT_EQ(reports().size(), 1u);
  rig.receipt(reports()[0].receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

/// Its STATUS could acknowledge the robot's next message, which the other gateway has and this one
/// may not have heard.
TEST_F(SharedMesh, WhatIsNotAcknowledgedWhenItGoesIsNotAcknowledgedLater) {
  take_over();
  rig.hear(first_robot, update_set, group);
  give_up();
  rig.receipt(reports().at(0).receipt.id);
  EXPECT_EQ(statuses(), 0u);
}

/// Without being told: the lease has ended.
TEST_F(SharedMesh, NothingIsAcknowledgedWithoutTheLease) {
  take_over();
  rig.hear(first_robot, update_set, group);
  is_owner = false;
  rig.receipt(reports().at(0).receipt.id);
  EXPECT_EQ(statuses(), 0u);
  is_owner = true;
  rig.run_for(280ms);
  rig.hear(first_robot, update_set, group);
  EXPECT_EQ(reports().size(), 2u) << "goes up once more";
  rig.receipt(reports().at(1).receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

/// Another gateway calls this one dead and commands the robot: no repeat may overtake that.
TEST_F(SharedMesh, ACommandIsNotSentWithoutTheLease) {
  take_over();
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff", group);
  rig.run_for(1s);
  const std::size_t before = rig.sent_to(first_robot).size();
  rig.command("nr1/run", {1});
  rig.run_for(20ms);
  const std::size_t sent = rig.sent_to(first_robot).size();
  EXPECT_EQ(sent, before + 1);
  rig.command("nr1/cmd", {10, 0, 20, 0});
  is_owner = false;
  rig.run_for(40s);
  EXPECT_EQ(rig.sent_to(first_robot).size(), sent);
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 2u);
  for (const CommandOutcome& outcome : outcomes) EXPECT_EQ(outcome.result, CommandResult::refused);
}

TEST_F(SharedMesh, ARetainedCommandComesFromTheOwnerOnly) {
  rig.hear(first_robot, update_set, group);
  rig.command("nr1/run", {1}, true);
  rig.run_for(1s);
  EXPECT_TRUE(rig.sent_to(first_robot).empty());
  const std::size_t subscribed = rig.all<SubscribeRequest>().size();
  take_over();
  EXPECT_GT(rig.all<SubscribeRequest>().size(), subscribed) << "the broker sends it again";
  rig.command("nr1/run", {1}, true);
  EXPECT_EQ(statuses(), 1u);
  give_up();
  rig.run_for(20s);
  const std::size_t asked = rig.all<SubscribeRequest>().size();
  take_over();
  EXPECT_EQ(rig.all<SubscribeRequest>().size(), asked) << "it has had it";
}

/// The robot stands still: the same update again is a new message, of which another gateway may
/// know nothing.
TEST_F(SharedMesh, WhatWasAnsweredBeforeIsNotTakenForARepeat) {
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
    is_owner = false;
    rig.run_for(10s);
    rig.hear(first_robot, text, group);  // another gateway's, while the lease had ended
    is_owner = true;
    rig.run_for(280ms);
    rig.hear(first_robot, text, group);
    EXPECT_EQ(reports().size(), before + 3);
    give_up();
  }
}

/// Its owner has died: the robot need not repeat it once more.
TEST_F(SharedMesh, WhatNobodyAnswersGoesUpWhenTheRobotIsTakenOver) {
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

TEST_F(SharedMesh, WhatIsNotRepeatedAnyMoreWasAnswered) {
  rig.hear(first_robot, update_set, group);
  rig.run_for(280ms);
  rig.hear(first_robot, update_set, group);
  rig.run_for(1s);  // the next copy would have come
  take_over();
  EXPECT_TRUE(reports().empty());
}

/// The copies that come later fit the schedule of the first one, which nobody served.
TEST_F(SharedMesh, WhatWentUpWhenTheRobotWasTakenOverIsKnownWhenItComesAgain) {
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

TEST_F(SharedMesh, CommandsEndWhenTheRobotGoes) {
  take_over();
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff", group);
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.run_for(10ms);
  EXPECT_EQ(rig.sent_to(first_robot).size(), 1u);
  give_up();
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  rig.run_for(10s);
  EXPECT_EQ(rig.sent_to(first_robot).size(), 1u)
      << "no repeat overtakes the other gateway's commands";
}

TEST_F(SharedMesh, WhoTakesARobotOverSaysThatItIsThere) {
  rig.hear(first_robot, update_set, group);
  const std::size_t before = rig.all<PresenceChange>().size();
  take_over();
  const auto changes = rig.all<PresenceChange>();
  ASSERT_EQ(changes.size(), before + 1);
  EXPECT_EQ(changes.back().presence, Presence::online);
}

struct Alone : SharedMesh {
  Alone() : SharedMesh(test_database()) {}
};

TEST_F(Alone, NobodyIsAskedInAMeshOfOneGateway) {
  rig.hear(first_robot, update_set, group);
  EXPECT_EQ(reports().size(), 1u);
  EXPECT_TRUE(rig.heard.empty());
  give_up();
  rig.receipt(reports()[0].receipt.id);
  EXPECT_EQ(statuses(), 1u);
}

}  // namespace
}  // namespace slamgw::ble
