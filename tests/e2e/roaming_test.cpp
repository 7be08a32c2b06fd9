// SPDX-License-Identifier: Apache-2.0
// Two gateways on one broker, and robots that go from one to the other without a word.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

class TwoGateways : public testing::Test {
 protected:
  static json configuration(const Mosquitto& broker, const std::string& id) {
    return {{"gateway", {{"id", id}}}, {"broker", {{"uri", broker.uri()}}}};
  }
  void SetUp() override {
    for (GatewayProcess* gateway : {&a, &b})
      ASSERT_TRUE(eventually([&] { return state_of(*gateway) == "member"; })) << gateway->log();
  }
  /// What a gateway says of itself.
  static std::string state_of(const GatewayProcess& gateway) {
    const json fleet = gateway.ctl({"fleet"});
    return fleet.is_object() ? fleet["gateways"][0].value("state", "") : "";
  }
  /// Where a gateway believes a robot to be.
  std::size_t count(const std::string& start) const {
    const auto lines = everything.lines();
    return static_cast<std::size_t>(
        std::ranges::count_if(lines, [&](const auto& line) { return line.starts_with(start); }));
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
  // Without a session of the robot there is nothing that a could publish its will for.
  ASSERT_TRUE(eventually([&] { return a.ctl({"robots"}).empty(); })) << a.log();

  // The subscription came along; the gateway tells the topic's id anew.
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

/// The broker has lost its retained states, and `b` is not back yet.
TEST_F(TwoGateways, AGatewayThatStartsAgainRemembersThatItIsNotAlone) {
  ASSERT_TRUE(eventually([&] { return std::filesystem::exists(a / "store/other-gateways"); }));
  a.process().send_signal(SIGKILL);
  EXPECT_TRUE(a.process().wait());
  b.process().send_signal(SIGKILL);
  broker.kill();
  broker.start();
  const std::size_t before = a.log().size();
  a.start();
  ASSERT_TRUE(eventually([&] { return state_of(a) == "member"; })) << a.log();
  EXPECT_EQ(a.log().substr(before).find("is on this broker too"), std::string::npos) << a.log();
}

/// NATS does not bring everything to subscribers with QoS 1, and takes its time to take them.
TEST(FleetAtMqtt311, WhatGatewaysSayAndCommandsAreHeardWithQos0) {
  const TempDir directory;
  const std::string log = directory / "mosquitto.log";
  BrokerOfVersion broker(MqttVersion::v3_1_1, "log_dest file " + log + "\nlog_type subscribe\n");
  const GatewayProcess a({{"gateway", {{"id", "a"}}}, {"broker", {{"uri", broker.link_uri()}}}});
  const GatewayProcess b({{"gateway", {{"id", "b"}}}, {"broker", {{"uri", broker.link_uri()}}}});
  ASSERT_TRUE(eventually([&] {
    return a.ctl({"fleet"}).dump().find("member") != std::string::npos;
  })) << a.log();
  for (const char* subscription :
       {" 0 ntnu-slam/fleet/all/+", " 0 ntnu-slam/fleet/to/a/+", " 0 ntnu-slam/gateway/+/state",
        " 0 ntnu-slam/gateway/+/commands/+", " 0 ntnu-slam/server/+/+"})
    EXPECT_TRUE(eventually([&] { return read_file(log).find(subscription) != std::string::npos; }))
        << subscription;
  for (const char* subscription : {" 1 ntnu-slam/fleet/", " 1 ntnu-slam/server/+/+"})
    EXPECT_EQ(read_file(log).find(subscription), std::string::npos) << subscription;
}

}  // namespace
}  // namespace slamgw::test
