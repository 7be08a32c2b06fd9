// SPDX-License-Identifier: Apache-2.0
// Retained messages about the gateway and its robots, and the counters, through faults and all
// kinds of exit. A later subscriber must not receive an outdated state.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr const char* state_topic = "ntnu-slam/gateway/test/state";

json retaining_configuration(const Mosquitto& broker) {
  return {{"broker", {{"uri", broker.uri()}}}};
}

std::vector<std::string> robots_of(const GatewayProcess& gateway,
                                   std::initializer_list<std::string> options) {
  EXPECT_TRUE(eventually([&] { return gateway.logs(" connected "); })) << gateway.log();
  std::vector<std::string> arguments{"thread", "--gateway", gateway.mqttsn_address()};
  arguments.insert(arguments.end(), options);
  return arguments;
}

/// Returns `"state"` of the first retained message that a new subscriber receives.
std::string retained_state(const Mosquitto& broker, const std::string& topic) {
  Subscriber late(broker, topic, "%r %p");
  if (!eventually([&] { return !late.lines().empty(); })) return "nothing";
  const std::string line = late.lines().front();
  return line.starts_with("1 ") ? json::parse(line.substr(2))["state"] : "not retained";
}

TEST(RetainedState, ReportsFullStoreUntilItHasRoom) {
  Mosquitto broker;
  Mosquitto other;
  Subscriber subscriber(other, state_topic, "%p");
  json configuration = retaining_configuration(broker);
  configuration["store"]["max_bytes"] = 20000;
  GatewayProcess gateway(configuration);
  SimulatorProcess robots(robots_of(gateway, {"--robots", "5", "--rate", "20"}));
  ASSERT_TRUE(eventually([&] { return gateway.logs("robot5 is online"); })) << gateway.log();
  broker.kill();
  ASSERT_TRUE(eventually([&] { return gateway.logs("the store is full"); })) << gateway.log();

  gateway.reload([&](json& wanted) { wanted["broker"]["uri"] = other.uri(); });

  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() >= 2; })) << gateway.log();
  const auto lines = subscriber.lines();
  EXPECT_EQ(json::parse(lines.front())["store"], "full");
  EXPECT_EQ(json::parse(lines.front())["state"], "online");
  EXPECT_FALSE(json::parse(lines.back()).contains("store")) << lines.back();
}

TEST(RetainedState, IsOnlineAgainAfterCrashAndRestart) {
  Mosquitto broker;
  Subscriber subscriber(broker, state_topic, "%p");
  GatewayProcess gateway(retaining_configuration(broker));
  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() == 1; })) << gateway.log();
  gateway.process().send_signal(SIGKILL);
  ASSERT_TRUE(eventually([&] { return !gateway.process().is_running(); }));
  gateway.start();
  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() >= 3; })) << gateway.log();
  std::vector<std::string> states;
  for (const std::string& line : subscriber.lines()) states.push_back(json::parse(line)["state"]);
  // A gateway that was killed before it received its own state back publishes it twice: the
  // broker's session gives the old copy to the next process, which takes the last will for a late
  // one.
  states.erase(std::unique(states.begin(), states.end()), states.end());
  EXPECT_EQ(states, (std::vector<std::string>{"online", "offline", "online"}));
  EXPECT_EQ(retained_state(broker, state_topic), "online");
}

TEST(RetainedState, IsPublishedAgainToBrokerThatLostIt) {
  Mosquitto broker;
  GatewayProcess gateway(retaining_configuration(broker));
  SimulatorProcess robots(robots_of(gateway, {"--robots", "1"}));
  ASSERT_TRUE(eventually([&] { return gateway.logs("robot1 is online"); })) << gateway.log();
  broker.kill();
  broker.start();
  for (const char* topic : {state_topic, "ntnu-slam/gateway/test/robots/robot1"})
    EXPECT_TRUE(eventually([&] { return retained_state(broker, topic) == "online"; })) << topic;
}

TEST(RetainedPresence, IsOfflineAfterRestartForRobotThatLeftDuringCrash) {
  Mosquitto broker;
  GatewayProcess gateway(retaining_configuration(broker));
  {
    SimulatorProcess robots(robots_of(gateway, {"--robots", "1", "--keep-alive", "1"}));
    ASSERT_TRUE(eventually([&] { return gateway.logs("robot1 is online"); })) << gateway.log();
    EXPECT_TRUE(eventually([&] {  // the line is written before the broker has the presence
      return retained_state(broker, "ntnu-slam/gateway/test/robots/robot1") == "online";
    }));
    ASSERT_TRUE(eventually([&] {
      return read_files(gateway / "store/sessions").find("robot1") != std::string::npos;
    }));
    gateway.process().send_signal(SIGKILL);
    robots.process().send_signal(SIGKILL);
    ASSERT_TRUE(eventually(
        [&] { return !gateway.process().is_running() && !robots.process().is_running(); }));
  }
  gateway.start();
  EXPECT_TRUE(eventually([&] {
    return retained_state(broker, "ntnu-slam/gateway/test/robots/robot1") == "offline";
  })) << gateway.log();
}

TEST(Stats, HaveSameMembersAsStatusOfSlamGatewayctl) {
  Mosquitto broker;
  Subscriber subscriber(broker, "ntnu-slam/gateway/test/stats", "%r %p");
  GatewayProcess gateway(retaining_configuration(broker));
  ASSERT_TRUE(eventually([&] { return !subscriber.lines().empty(); })) << gateway.log();
  const std::string line = subscriber.lines().front();
  EXPECT_TRUE(line.starts_with("0 ")) << "old counters are not retained";
  const json stats = json::parse(line.substr(2));
  const json status = gateway.ctl({"status"});
  std::vector<std::string> keys[2];
  for (const auto& [key, value] : stats.items()) keys[0].push_back(key);
  for (const auto& [key, value] : status.items()) keys[1].push_back(key);
  EXPECT_EQ(keys[0], keys[1]);
  EXPECT_EQ(stats["broker"]["state"], "up");
}

}  // namespace
}  // namespace slamgw::test
