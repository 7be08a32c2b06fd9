// SPDX-License-Identifier: Apache-2.0
// An operator gets the outcome of their own command, also beside other commands to the same robot.
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

/// The core and the operators, as App joins them; the test is the mesh.
class OperatorCommandsTest : public testing::Test {
 protected:
  void server_sends(const std::string& topic) {
    gateway.commands().on_robot_message({"r", {topic, {1, 2, 3, 4}, Qos::at_least_once, false}},
                                        now);
    drain();
  }
  void operator_sends(const std::string& robot, const std::string& type) {
    const auto done = [this](const CommandOutcome& outcome) { reported.push_back(outcome); };
    gateway.commands().on_operator_command({"uid 0", done}, robot, type, {5, 6, 7, 8}, now);
    drain();
  }
  void mesh_ends(CommandId command, CommandResult result) {
    gateway.on_mesh_event(CommandOutcome{Mesh::thread, command, "r", "cmd", result, 5ms, ""}, now);
    drain();
  }
  void drain() {
    while (auto action = gateway.next_action()) {
      if (const auto* deliver = std::get_if<DeliverToMesh>(&*action))
        delivered.push_back(deliver->message.command);
      if (const auto* answer = std::get_if<AnswerAsker>(&*action))
        answer->asker->done(answer->outcome);
    }
  }

  static constexpr std::size_t max_open = 3;
  Now now{TimePoint{1h}, {}};
  BrokerLink broker{true, {}, {}};
  std::optional<Presence> presence = Presence::online;
  Gateway gateway{TopicScheme("p", "g"),
                  {"1", UpdateMode::positions, {}, max_open},
                  broker,
                  [this](Mesh, const std::string&) { return presence; }};
  void expect_refused_at_once(const std::string& why) const {
    ASSERT_EQ(reported.size(), 1U);
    EXPECT_EQ(reported[0].result, CommandResult::refused);
    EXPECT_EQ(reported[0].why, why);
    EXPECT_TRUE(delivered.empty());
  }

  std::vector<CommandId> delivered;
  std::vector<CommandOutcome> reported;
};

TEST_F(OperatorCommandsTest, ReportTheirOwnOutcomeBesideEqualCommandsToTheSameRobot) {
  constexpr CommandResult fates[] = {CommandResult::refused, CommandResult::delivered,
                                     CommandResult::superseded};
  std::vector<int> order{0, 1, 2};
  do {  // in each order of their ends
    delivered.clear();
    reported.clear();
    server_sends("p/server/r/cmd");
    operator_sends("r", "cmd");
    server_sends("p/server/r/cmd");
    ASSERT_EQ(delivered.size(), 3u);
    for (const int which : order)
      mesh_ends(delivered[static_cast<std::size_t>(which)], fates[which]);
    ASSERT_EQ(reported.size(), 1u);
    EXPECT_EQ(reported[0].result, CommandResult::delivered);
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST_F(OperatorCommandsTest, ReportOneOutcomeAndIgnoreThoseOfOtherCommands) {
  operator_sends("r", "cmd");
  mesh_ends(CommandId::none, CommandResult::delivered);  // from before a restart
  EXPECT_TRUE(reported.empty());
  mesh_ends(delivered[0], CommandResult::timeout);
  mesh_ends(delivered[0], CommandResult::delivered);
  ASSERT_EQ(reported.size(), 1u);
  EXPECT_EQ(reported[0].result, CommandResult::timeout);
}

TEST_F(OperatorCommandsTest, EndWithinHalfAMinuteEvenWhenTheMeshIsSilent) {
  operator_sends("r", "cmd");
  now.mono += 30s;
  gateway.on_deadline(now);
  drain();
  ASSERT_EQ(reported.size(), 1u);
  EXPECT_EQ(reported[0].result, CommandResult::timeout);
}

TEST_F(OperatorCommandsTest, ThatCannotBeSentEndAtOnce) {
  presence = std::nullopt;
  operator_sends("stranger", "cmd");
  ASSERT_EQ(reported.size(), 1u);
  EXPECT_EQ(reported[0].result, CommandResult::refused);
  EXPECT_EQ(reported[0].why, "no robot of this name is known here");
}

TEST_F(OperatorCommandsTest, ToARobotOfAnotherGatewayEndAtOnce) {
  RobotPlaces places;
  bool is_held = false;
  places.is_held = [&](const std::string&) { return is_held; };
  places.is_elsewhere = [](const std::string&) { return true; };
  gateway.set_places(places);
  operator_sends("r", "cmd");
  expect_refused_at_once("another gateway serves this robot");
  is_held = true;
  operator_sends("r", "cmd");
  EXPECT_EQ(delivered.size(), 1u);
}

TEST_F(OperatorCommandsTest, ThatTheRobotHasNotSubscribedToEndAtOnce) {
  RobotPlaces places;
  places.may_want = [](const std::string&, const std::string& topic) {
    return topic == "p/server/r/run";
  };
  gateway.set_places(places);
  operator_sends("r", "cmd");
  expect_refused_at_once("the robot has not subscribed to p/server/r/cmd");
  operator_sends("r", "run");
  EXPECT_EQ(delivered.size(), 1u);
}

TEST_F(OperatorCommandsTest, ForwardedToAnotherGatewayEndForTheirSender) {
  operator_sends("r", "cmd");
  gateway.commands().on_handed_on(delivered[0]);
  drain();
  ASSERT_EQ(reported.size(), 1u);
  EXPECT_EQ(reported[0].result, CommandResult::timeout);
  EXPECT_EQ(reported[0].why, "the robot moved to another gateway, which has the command now");
  gateway.commands().on_handed_on(delivered[0]);
  mesh_ends(delivered[0], CommandResult::delivered);
  EXPECT_EQ(reported.size(), 1u);
}

TEST_F(OperatorCommandsTest, AreBounded) {
  for (std::size_t i = 0; i < max_open; ++i) operator_sends("r", "cmd");
  EXPECT_TRUE(reported.empty());
  operator_sends("r", "cmd");
  ASSERT_EQ(reported.size(), 1u);
  EXPECT_EQ(reported[0].result, CommandResult::refused);
  mesh_ends(delivered[0], CommandResult::delivered);
  operator_sends("r", "cmd");
  EXPECT_EQ(reported.size(), 2u) << "there is room again";
}

}  // namespace
}  // namespace slamgw
