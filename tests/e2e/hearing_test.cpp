// SPDX-License-Identifier: Apache-2.0
// Which BLE robots hear which, measured at a gateway: over a relay, and where none relays.
#include <gtest/gtest.h>

#include <map>
#include <string>
#include <vector>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

/// Returns the names of the robots in their order in space: UUIDs end with the robots' numbers.
/// Empty while not all are configured.
std::vector<std::string> robots_in_order(const json& nodes) {
  std::map<std::string, std::string> by_number;
  for (const json& node : nodes)
    if (node["state"] == "configured")
      by_number[node["uuid"].get<std::string>().substr(28)] = node["robot"];
  std::vector<std::string> robots;
  for (const auto& [number, robot] : by_number) robots.push_back(robot);
  return robots.size() == 4 ? robots : std::vector<std::string>();
}

json row_of(const json& result, const std::string& source, const std::string& listener) {
  for (const json& row : result["rows"])
    if (row["source"] == source && row["listener"] == listener) return row;
  return nullptr;
}

/// Four robots in a row, each of which hears its neighbours. The third does not relay.
TEST(HearingOfRobots, IsMeasuredBesideTheirTraffic) {
  Mosquitto broker;
  GatewayProcess gateway({{"broker", {{"uri", broker.uri()}}}, {"ble_mesh", {{"enabled", true}}}});
  SimulatorProcess simulator({"ble", "--tty", gateway.tty(), "--unprovisioned", "--robots", "4",
                              "--rate", "5", "--acknowledged", "--firmware", "2.2.0",
                              "--robot-reach", "1"});
  std::vector<std::string> robots;
  const auto are_configured = [&] {
    robots = robots_in_order(gateway.ctl({"ble", "nodes"}));
    return !robots.empty();
  };
  ASSERT_TRUE(eventually(are_configured, std::chrono::seconds{120})) << gateway.log();
  const json changed = gateway.ctl({"ble", "config", robots[2], "--relay", "off"});
  ASSERT_TRUE(changed.is_object()) << gateway.log();
  ASSERT_EQ(changed["relay"]["state"], "off") << changed;

  json result;  // takes longer than one call waits; the next call continues the measurement
  const auto is_measured = [&] {
    result = gateway.ctl({"ble", "topology", "--measure"});
    return result.is_object();
  };
  ASSERT_TRUE(eventually(is_measured, std::chrono::seconds{240})) << gateway.log();
  EXPECT_EQ(result["state"], "done") << result << gateway.log();
  EXPECT_EQ(result["rows"].size(), 12u);
  const json direct = row_of(result, robots[1], robots[0]);
  EXPECT_EQ(direct["heard"], 8) << result;
  EXPECT_EQ(direct["max_hops"], 1);
  const json relayed = row_of(result, robots[0], robots[2]);
  EXPECT_EQ(relayed["heard"], 8) << result;
  EXPECT_EQ(relayed["min_hops"], 2);
  EXPECT_EQ(row_of(result, robots[1], robots[3])["heard_at_most"], 0) << result;
  EXPECT_EQ(row_of(result, robots[3], robots[0])["heard_at_most"], 0) << result;
  EXPECT_TRUE(result["silent"].empty());
  EXPECT_EQ(gateway.ctl({"send", robots[1], "cmd", "10,-20"})["outcome"], "delivered");
}

}  // namespace
}  // namespace slamgw::test
