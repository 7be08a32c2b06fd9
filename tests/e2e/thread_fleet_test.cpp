// SPDX-License-Identifier: Apache-2.0
// Every kind of simulated Thread robot against the daemon and a real Mosquitto. Robots sleep, move,
// change their will, vanish or never connect. One fleet is on a bad radio.
#include <gtest/gtest.h>

#include <signal.h>
#include <set>

#include <algorithm>
#include <filesystem>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

/// Waits until the daemon answers SEARCHGW, which requires a connection to the broker.
std::vector<std::string> thread_arguments(const GatewayProcess& gateway,
                                          const std::vector<std::string>& options) {
  EXPECT_TRUE(eventually([&] { return gateway.logs(" connected "); })) << gateway.log();
  std::vector<std::string> arguments{"thread", "--gateway", gateway.mqttsn_address()};
  arguments.insert(arguments.end(), options.begin(), options.end());
  return arguments;
}

/// Runs tests/e2e/fleet_check: acknowledged messages are upstream, once and in order.
Finished check_fleet(MqttVersion version, const std::vector<std::string>& options) {
  const std::string only = version == MqttVersion::v3_1_1 ? "MQTT=3" : "MQTT=5";
  std::vector<std::string> arguments{
      "env",           only, SLAMGW_FLEET_CHECK, std::filesystem::path(SLAMGW_SIM).parent_path(),
      "--outstanding", "1"};
  arguments.insert(arguments.end(), options.begin(), options.end());
  return run_program(arguments, 4 * patience);  // robots repeat for up to half a minute
}

std::string state_of(const GatewayProcess& gateway, const std::string& robot) {
  const json robots = gateway.ctl({"robots"});
  for (const json& row : robots.is_object() ? robots["robots"] : robots) {
    if (row["id"] == robot) return row["state"];
  }
  return {};
}

using ThreadFleet = OverEitherVersion;
INSTANTIATE_TEST_SUITE_P(Over, ThreadFleet, either_version, ThreadFleet::name);

TEST_P(ThreadFleet, SleepingRobotGetsCommandOnceWhenItWakes) {
  GatewayProcess gateway(json{{"broker", {{"uri", broker.link_uri()}}}});
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/#", "%p");
  Subscriber updates(broker, "ntnu-slam/robot/robot1/update");
  SimulatorProcess simulator(
      thread_arguments(gateway, {"--robots", "1", "--sleep", "2", "--rate", "0.5"}));
  ASSERT_TRUE(eventually([&] { return state_of(gateway, "robot1") == "asleep"; })) << gateway.log();

  mosquitto_publish(broker, {"-q", "0", "-t", "ntnu-slam/server/robot1/run", "-m", "stop"});
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/robot1/run", "-m", "start"});

  ASSERT_TRUE(eventually([&] { return outcomes.lines().size() == 2; })) << gateway.log();
  std::multiset<std::string> ends;
  for (const std::string& line : outcomes.lines()) ends.insert(json::parse(line)["outcome"]);
  EXPECT_EQ(ends, (std::multiset<std::string>{"delivered", "sent"}));
  // It wakes before each update, which would bring the commands again.
  const std::size_t before = updates.lines().size();
  ASSERT_TRUE(eventually([&] { return updates.lines().size() >= before + 2; })) << gateway.log();
  simulator.process().send_signal(SIGTERM);
  const json report = simulator.report();
  EXPECT_EQ(report["commands_received"], 2) << report;
  EXPECT_GE(report["wakes"], 2) << report;
}

TEST_P(ThreadFleet, SleepingRobotsLoseNoMessageOnBadRadio) {
  const Finished check =
      check_fleet(GetParam(), {"--robots", "20", "--sleep", "1", "--messages", "8", "--rate", "4",
                               "--loss", "0.05", "--retry", "0.3"});
  EXPECT_EQ(check.status, 0) << check.out << check.err;
  EXPECT_NE(check.out.find("\"wakes\""), std::string::npos) << check.out;
}

TEST_P(ThreadFleet, RoamingRobotsLoseNoMessageOnBadRadio) {
  const Finished check = check_fleet(
      GetParam(), {"--robots", "20", "--roam", "0.9", "--messages", "15", "--rate", "8", "--retry",
                   "0.35", "--delay-ms", "10", "--reorder", "0.1", "--duplicate", "0.1"});
  EXPECT_EQ(check.status, 0) << check.out << check.err;
  EXPECT_NE(check.out.find("\"roamed\""), std::string::npos) << check.out;
}

TEST_P(ThreadFleet, LargerFleetLosesNoAcknowledgedMessageOnBadRadio) {
  const Finished check = check_fleet(GetParam(), {"--robots", "100", "--loss", "0.1", "--messages",
                                                  "4", "--rate", "5", "--retry", "0.5"});
  EXPECT_EQ(check.status, 0) << check.out << check.err;
}

TEST_P(ThreadFleet, PublishesWillOfVanishedRobotOnly) {
  GatewayProcess gateway(json{{"broker", {{"uri", broker.link_uri()}}}});
  Subscriber wills(broker, "ntnu-slam/robot/+/will", "%t %p");
  SimulatorProcess simulator(thread_arguments(
      gateway, {"--robots", "2", "--messages", "3", "--keep-alive", "1", "--vanish", "0.5"}));
  EXPECT_EQ(simulator.report()["lost"], 0);
  ASSERT_TRUE(eventually([&] { return !wills.lines().empty(); })) << gateway.log();
  EXPECT_EQ(wills.lines(), std::vector<std::string>{"ntnu-slam/robot/robot2/will Disconnected"});
}

TEST_P(ThreadFleet, PublishesChangedWill) {
  GatewayProcess gateway(json{{"broker", {{"uri", broker.link_uri()}}}});
  Subscriber all(broker, "ntnu-slam/robot/robot1/+", "%t %p");
  SimulatorProcess simulator(
      thread_arguments(gateway, {"--robots", "1", "--messages", "6", "--will-updates", "0.3",
                                 "--keep-alive", "1", "--vanish", "1"}));
  const json report = simulator.report();
  const int changes = report.value("will_updates", 0);
  EXPECT_GE(changes, 1) << report;
  const auto said = [&](const std::string& line) {
    const std::vector<std::string> lines = all.lines();
    return std::find(lines.begin(), lines.end(), line) != lines.end();
  };
  // The last change may have arrived without its answer being seen.
  const std::string will = "ntnu-slam/robot/robot1/will-updated Disconnected after ";
  EXPECT_TRUE(eventually([&] {
    return said(will + std::to_string(changes)) || said(will + std::to_string(changes + 1));
  })) << gateway.log();
  EXPECT_FALSE(said("ntnu-slam/robot/robot1/will Disconnected"));
}

TEST_P(ThreadFleet, AcceptsRobotsWithoutConnectWhenAllowed) {
  GatewayProcess gateway(
      json{{"broker", {{"uri", broker.link_uri()}}},
           {"mqttsn",
            {{"allow_unconnected_publish", true},
             {"predefined_topics", {{{"id", 1}, {"name", "ntnu-slam/robot/robot1/update"}}}}}}});
  Subscriber updates(broker, "ntnu-slam/robot/robot1/update");
  SimulatorProcess simulator(
      thread_arguments(gateway, {"--robots", "1", "--messages", "5", "--qos", "-1"}));
  EXPECT_EQ(simulator.report()["sent"], 5);
  EXPECT_TRUE(eventually([&] { return updates.lines().size() == 5; })) << gateway.log();
}

}  // namespace
}  // namespace slamgw::test
