// SPDX-License-Identifier: Apache-2.0
// Robots that several gateways could serve: which ones the core shows, and which commands it takes.
#include "daemon/core/robot_registry.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

class RobotPlacesTest : public test::SharedGatewayRig {
 protected:
  void comes(const std::string& robot) {
    say(PresenceChange{Mesh::thread, robot, Presence::online, "a"});
  }
  /// Retained presence, by gateway and robot ("pi1/a"); withdrawn ones are "-pi1/a".
  std::vector<std::string> announced() {
    std::vector<std::string> all;
    for (const Upload& upload : drain<Upload>()) {
      const auto shown = scheme.parse_presence_topic(upload.message.topic);
      if (!shown) continue;
      EXPECT_TRUE(upload.message.retain);
      all.push_back((upload.message.payload.empty() ? "-" : "") + std::string(shown->gateway) +
                    "/" + std::string(shown->robot));
    }
    return all;
  }
  using Shown = std::vector<std::string>;
  const TopicScheme scheme{"ntnu-slam", "pi1"};
};

TEST_F(RobotPlacesTest, ARobotIsShownWhileNoOtherGatewayShowsIt) {
  broker_comes();
  comes("a");
  EXPECT_EQ(announced(), Shown{"pi1/a"});
  elsewhere.insert("b");
  comes("b");
  EXPECT_EQ(announced(), Shown{}) << "another gateway's";
  held.insert("b");
  comes("b");
  EXPECT_EQ(announced(), Shown{"pi1/b"}) << "the holder of the session shows it";
  left.insert("c");
  comes("c");
  EXPECT_EQ(announced(), Shown{"pi1/c"}) << "the other gateway is gone";
}

TEST_F(RobotPlacesTest, OnlyRobotsOfThisGatewayAreShownAgainAtANewConnection) {
  for (const char* robot : {"held", "lost", "new"}) comes(robot);
  elsewhere = {"held", "lost"};
  held = {"held"};
  broker_is(true);
  EXPECT_EQ(announced(), Shown{}) << "the robots of other gateways are not known yet";
  pass(PresencePublisher::settling);
  EXPECT_EQ(announced(), Shown{"pi1/new"}) << "the held one follows at on_session_held()";
  gateway.presence().announce_all(now);
  EXPECT_EQ(announced(), (Shown{"pi1/held", "pi1/new"}));
}

TEST_F(RobotPlacesTest, ARobotIsShownAsSoonAsItsSessionIsHeld) {
  broker_comes();
  elsewhere.insert("a");
  comes("a");
  EXPECT_EQ(announced(), Shown{});
  session_comes("a");
  EXPECT_EQ(announced(), Shown{"pi1/a"});
  session_comes("unknown here");
  EXPECT_EQ(announced(), Shown{});
}

TEST_F(RobotPlacesTest, ShowsAHeldRobotAtItsNextMessage) {
  broker_comes();
  elsewhere.insert("a");
  comes("a");
  say(update_from("a", {1, 0, 2, 0}));
  EXPECT_EQ(announced(), Shown{});
  held.insert("a");
  say(update_from("a", {1, 0, 2, 0}));
  EXPECT_EQ(announced(), Shown{"pi1/a"});
  say(update_from("a", {1, 0, 2, 0}));
  EXPECT_EQ(announced(), Shown{}) << "once";
}

TEST_F(RobotPlacesTest, WithdrawsTheEntryOfADeadGateway) {
  broker_comes();
  left = {"a", "b"};
  comes("a");
  EXPECT_EQ(announced(), Shown{"pi1/a"});
  session_comes("a", true, "pi9");
  EXPECT_EQ(announced(), (Shown{"-pi9/a", "pi1/a"}));
  session_comes("b", true, "pi9");
  EXPECT_EQ(announced(), Shown{"-pi9/b"}) << "also for a robot that is not here";
}

TEST_F(RobotPlacesTest, ARobotThatIsGivenUpIsWithdrawnAndForgotten) {
  broker_comes();
  comes("a");
  announced();
  gateway.presence().on_given_up("a");
  EXPECT_EQ(announced(), Shown{"-pi1/a"});
  EXPECT_FALSE(gateway.registry().find("a"));
}

TEST_F(RobotPlacesTest, ARobotThatIsGivenUpWhileTheBrokerIsAwayIsWithdrawnLater) {
  comes("a");
  gateway.presence().on_given_up("a");
  EXPECT_EQ(announced(), Shown{});
  broker_is(true);
  EXPECT_EQ(announced(), Shown{"-pi1/a"});
}

TEST_F(RobotPlacesTest, WithdrawsALeftoverRobotThatAnotherGatewayShows) {
  broker_comes();
  for (const char* robot : {"gone", "moved"})
    gateway.on_broker_message(
        {scheme.presence_topic(robot), to_bytes(R"({"state":"online"})"), Qos::at_least_once, true},
        now);
  elsewhere.insert("moved");
  pass(PresencePublisher::leftover_grace);
  EXPECT_EQ(announced(), (Shown{"pi1/gone", "-pi1/moved"}));
}

TEST_F(RobotPlacesTest, ARobotWithoutASessionIsNotShown) {
  say(update_from("a", {1, 0, 2, 0}));
  broker_comes();
  EXPECT_EQ(announced(), Shown{});
  gateway.presence().announce_all(now);
  gateway.presence().on_contested("a", true, now);
  EXPECT_EQ(announced(), Shown{}) << "it has neither state nor address";
}

/// After a failover, the broker may send no retained messages to wildcards.
TEST_F(RobotPlacesTest, ChecksAtEachConnectionWhetherTheBrokerSendsRetainedMessages) {
  is_alone = true;
  const auto hear_own_state = [&](bool retain) {
    gateway.on_broker_message({"ntnu-slam/gateway/pi1/state", to_bytes(R"({"state":"online"})"),
                               Qos::at_least_once, retain},
                              now);
  };
  comes("a");
  broker_is(true);
  hear_own_state(/*retain=*/true);
  EXPECT_EQ(announced(), Shown{});
  hear_own_state(/*retain=*/false);
  EXPECT_EQ(announced(), Shown{"pi1/a"}) << "no other gateway is there";
  broker_is(false);
  broker_is(true);
  hear_own_state(/*retain=*/false);
  EXPECT_EQ(announced(), Shown{}) << "other gateways may be there";
  pass(PresencePublisher::settling);
  EXPECT_EQ(announced(), Shown{"pi1/a"});
}

class ContestedTest : public RobotPlacesTest {
 protected:
  /// Returns `contested` of each presence that is published now.
  std::vector<bool> shown() {
    std::vector<bool> all;
    for (const Upload& upload : drain<Upload>())
      all.push_back(json::parse(as_text(upload.message.payload)).value("contested", false));
    return all;
  }
  using States = std::vector<bool>;
};

TEST_F(ContestedTest, IsShownWhileAnotherClientTakesTheRobotsSession) {
  broker_comes();
  held.insert("a");
  comes("a");
  EXPECT_EQ(shown(), States{false});
  EXPECT_EQ(gateway.registry().contested(), 0u);
  gateway.presence().on_contested("a", true, now);
  EXPECT_EQ(shown(), States{true});
  EXPECT_EQ(gateway.registry().contested(), 1u);
  gateway.presence().on_contested("a", true, now);
  EXPECT_EQ(shown(), States{}) << "unchanged";
  gateway.presence().on_contested("a", false, now);
  EXPECT_EQ(shown(), States{false});
  EXPECT_EQ(gateway.registry().contested(), 0u);
  gateway.presence().on_contested("unknown", true, now);
  EXPECT_EQ(shown(), States{});
}

TEST_F(ContestedTest, IsShownWhileTheMeshReportsIt) {
  broker_comes();
  PresenceChange change{Mesh::thread, "a", Presence::online, "x"};
  say(change);
  change.is_contested = true;
  say(change);
  EXPECT_EQ(shown(), (States{false, true}));
  EXPECT_EQ(gateway.registry().contested(), 1u);
  change.is_contested = false;
  say(change);
  EXPECT_EQ(shown(), States{false});
}

TEST_F(ContestedTest, KeepsTheTimeOfTheRobotsState) {
  broker_comes();
  comes("a");
  const auto since = [&](bool is_contested) {
    now.wall += 5s;
    PresenceChange change{Mesh::thread, "a", Presence::online, "x"};
    change.is_contested = is_contested;
    say(change);
    return json::parse(as_text(drain<Upload>().back().message.payload))["since"];
  };
  const json before = json::parse(as_text(drain<Upload>().back().message.payload))["since"];
  EXPECT_EQ(since(true), before);
  EXPECT_EQ(since(false), before);
}

class OperatorCommandTest : public RobotPlacesTest {
 protected:
  std::string refusal_of(const std::string& robot) {
    const CommandId id = gateway.commands().on_operator_command({"uid 0"}, robot, "run", {1}, now);
    std::string why;
    while (auto action = gateway.next_action()) {
      if (const auto* outcome = std::get_if<CommandOutcome>(&*action)) {
        EXPECT_EQ(outcome->id, id);
        EXPECT_EQ(outcome->result, CommandResult::refused);
        why = outcome->why;
      }
      if (const auto* delivery = std::get_if<DeliverToMesh>(&*action)) {
        EXPECT_EQ(delivery->message.command, id);
        EXPECT_EQ(delivery->message.message.topic, "ntnu-slam/server/" + robot + "/run");
        EXPECT_EQ(delivery->message.robot, robot);
      }
    }
    return why;
  }
};

TEST_F(OperatorCommandTest, IsRefusedWhenAnotherGatewayServesTheRobot) {
  reach[{Mesh::thread, "a"}] = Presence::online;
  EXPECT_EQ(refusal_of("a"), "");
  elsewhere.insert("a");
  EXPECT_EQ(refusal_of("a"), "another gateway serves this robot");
  held.insert("a");
  EXPECT_EQ(refusal_of("a"), "") << "the holder of the session sends commands";
}

TEST_F(OperatorCommandTest, IsRefusedAsUnknownOrAsNotConnected) {
  EXPECT_EQ(refusal_of("unknown"), "no robot of this name is known here");
  held.insert("adopted");
  EXPECT_EQ(refusal_of("adopted"), "the robot is not connected");
  left.insert("orphan");
  EXPECT_EQ(refusal_of("orphan"), "the robot is not connected");
}

TEST_F(RobotPlacesTest, RefusesACommandForAnAbsentRobotOfAnyGatewayAsNotConnected) {
  for (auto* place : {&held, &left}) {
    held.clear();
    place->insert("a");
    gateway.commands().on_robot_message({"a", {"ntnu-slam/server/a/cmd", {}, Qos::at_least_once}},
                                        now);
    const auto outcomes = drain<CommandOutcome>();
    ASSERT_EQ(outcomes.size(), 1u);
    EXPECT_EQ(outcomes[0].why, "the robot is not connected");
  }
}

}  // namespace
}  // namespace slamgw
