// SPDX-License-Identifier: Apache-2.0
// Two gateways on one broker, and robots that move between them without DISCONNECT.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

class TwoGateways : public testing::Test {
 protected:
  explicit TwoGateways(const std::string& of_broker = {}) : broker(of_broker) {}
  static json configuration(const Mosquitto& broker, const std::string& id) {
    return {{"gateway", {{"id", id}}}, {"broker", {{"uri", broker.uri()}}}};
  }
  void SetUp() override {
    for (GatewayProcess* gateway : {&a, &b})
      ASSERT_TRUE(eventually([&] { return state_of(*gateway) == "member"; })) << gateway->log();
  }
  /// Returns the state of a gateway in its own view of the fleet.
  static std::string state_of(const GatewayProcess& gateway) {
    const json fleet = gateway.ctl({"fleet"});
    return fleet.is_object() ? fleet["gateways"][0].value("state", "") : "";
  }
  /// Counts the messages whose text begins with `start`.
  std::size_t count(const std::string& start) const {
    const auto lines = everything.lines();
    return static_cast<std::size_t>(
        std::ranges::count_if(lines, [&](const auto& line) { return line.starts_with(start); }));
  }
  /// Serves r1 at gateway a, which is then killed. Gateway b takes the session over.
  void leave_to_b(Device& r1) {
    r1.connect_with_will("r1");
    r1.subscribe("ntnu-slam/server/r1/cmd");
    ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "a"; })) << b.log();
    a.process().send_signal(SIGKILL);
    ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "b"; })) << b.log();
  }

  Mosquitto broker;
  Subscriber everything{broker, "ntnu-slam/#", "%t %p"};
  GatewayProcess a{configuration(broker, "a")};
  GatewayProcess b{configuration(broker, "b")};
};

TEST_F(TwoGateways, RobotThatMovesHasOneGatewayOneOutcomeAndNoWill) {
  Device at_a{a.mqttsn_address()};
  at_a.connect_with_will("r1");
  at_a.subscribe("ntnu-slam/server/r1/cmd");
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "a"; })) << b.log();

  Device at_b{b.mqttsn_address()};
  at_b.connect_with_will("r1");
  ASSERT_TRUE(eventually([&] { return a.place_in_fleet("r1") == "b"; })) << a.log();
  // Gateway a has no session of the robot any more, so it cannot publish the will.
  ASSERT_TRUE(eventually([&] { return a.ctl({"robots"}).empty(); })) << a.log();

  // The subscription moved along; the gateway registers the topic again.
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "1,2"});
  at_b.obey();
  ASSERT_TRUE(eventually([&] { return count("ntnu-slam/gateway/b/commands/r1") == 1; }));
  EXPECT_EQ(count("ntnu-slam/robot/r1/gone"), 0U);
  EXPECT_EQ(count("ntnu-slam/gateway/a/commands/r1"), 0U);

  const Subscriber presence{broker, "ntnu-slam/gateway/+/robots/r1", "%t %p"};
  ASSERT_TRUE(eventually([&] { return !presence.lines().empty(); }));
  for (const std::string& line : presence.lines())
    EXPECT_TRUE(line.starts_with("ntnu-slam/gateway/b/robots/r1 {\"state\":\"online\"")) << line;
}

TEST_F(TwoGateways, RobotOfDeadGatewayGetsCommandsAtNextOne) {
  Device at_a{a.mqttsn_address()};
  at_a.connect_with_will("r1");
  at_a.subscribe("ntnu-slam/server/r1/cmd");
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "a"; })) << b.log();
  a.process().send_signal(SIGKILL);
  Device at_b{b.mqttsn_address()};
  at_b.connect_with_will("r1");
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "b"; })) << b.log();
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "1,2"});
  at_b.obey();
  EXPECT_TRUE(eventually([&] { return count("ntnu-slam/gateway/b/commands/r1") == 1; }));
}

TEST_F(TwoGateways, OtherGatewayRefusesCommandsForRobotsOfDeadOne) {
  Device robot{a.mqttsn_address()};
  leave_to_b(robot);
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "1,2"});
  ASSERT_TRUE(eventually([&] { return count("ntnu-slam/gateway/b/commands/r1") == 1; })) << b.log();
  EXPECT_EQ(count("ntnu-slam/gateway/b/commands/r1 {\"type\":\"cmd\",\"outcome\":\"refused\""), 1U);
}

/// The broker was down when the gateway died, so it publishes no last will.
TEST_F(TwoGateways, OtherGatewayTakesOverRobotsAfterBrokerRestart) {
  Device robot{a.mqttsn_address()};
  robot.connect_with_will("r1");
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "a"; })) << b.log();
  broker.kill();
  a.process().send_signal(SIGKILL);
  broker.start();
  EXPECT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "b"; })) << b.log();
}

/// RabbitMQ sends no retained messages to a wildcard subscription either.
class TwoGatewaysWithoutRetainedMessages : public TwoGateways {
 protected:
  TwoGatewaysWithoutRetainedMessages() : TwoGateways("retain_available false\n") {}
  bool have_shown_themselves(std::size_t times) const {
    return count("ntnu-slam/gateway/a/state {\"state\":\"online\"") >= times &&
           count("ntnu-slam/gateway/b/state {\"state\":\"online\"") >= times;
  }
};

/// Gateway b disconnects normally, so gateway a receives no last will.
TEST_F(TwoGatewaysWithoutRetainedMessages, PublishStateAgainWhenOneReconnects) {
  ASSERT_TRUE(eventually([&] { return have_shown_themselves(2); })) << a.log() << b.log();
  b.reload([](json& wanted) { wanted["broker"]["keep_alive_s"] = 31; });
  EXPECT_TRUE(eventually([&] { return have_shown_themselves(3); })) << a.log() << b.log();
  EXPECT_EQ(state_of(b), "member");
}

/// The other gateway has not heard the robot, so it yields the robot.
TEST_F(TwoGateways, RestartedGatewayTakesItsRobotsBack) {
  Device robot{a.mqttsn_address()};
  leave_to_b(robot);
  a.start();
  const auto knows_other = [&] {
    const json fleet = a.ctl({"fleet"});
    return fleet.is_object() && std::ranges::any_of(fleet["robots"], [](const json& row) {
             return row["robot"] == "r1" && row["gateway"] == "b";
           });
  };
  ASSERT_TRUE(eventually(knows_other)) << a.log();
  robot.insist(sim::sn::pingreq({}), sim::sn::Type::pingresp);
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "a"; })) << b.log();
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "1,2"});
  robot.expect(sim::sn::Type::publish);
  EXPECT_EQ(count("ntnu-slam/robot/r1/gone"), 0U);
}

TEST_F(TwoGateways, CommandForUnknownRobotIsRefusedOnce) {
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/ghost/cmd", "-m", "1,2"});
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/probe/cmd", "-m", "1,2"});
  ASSERT_TRUE(eventually([&] { return count("ntnu-slam/gateway/a/commands/") == 2; })) << a.log();
  EXPECT_EQ(count("ntnu-slam/gateway/b/commands/"), 0U);
}

/// A client that connects with a robot's client id takes the session; the gateway takes it back.
TEST_F(TwoGateways, ReclaimsSessionFromAnotherClientAtNextMessage) {
  Device robot{a.mqttsn_address()};
  robot.connect_with_will("r1");
  robot.subscribe("ntnu-slam/server/r1/cmd");
  ASSERT_TRUE(eventually([&] { return b.place_in_fleet("r1") == "a"; })) << b.log();
  const auto contested = [&] { return a.ctl({"robots"})[0].value("contested", false); };
  ASSERT_TRUE(eventually([&] {
    mosquitto_publish(broker, {"-i", "ntnu-slam-robot-r1", "-t", "x", "-m", "y"});
    robot.insist(sim::sn::pingreq({}), sim::sn::Type::pingresp);
    return contested();
  })) << a.log();
  EXPECT_GE(count("ntnu-slam/gateway/a/robots/r1 {\"state\":\"online\""), 1U);
  EXPECT_TRUE(a.logs("a foreign client")) << a.log();
}

}  // namespace
}  // namespace slamgw::test
