// SPDX-License-Identifier: Apache-2.0
// A key refresh of the BLE mesh on a bad radio, during which the daemon is killed. Only the robot
// that is left behind is lost.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <map>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr std::size_t mesh_size = 20;
constexpr const char* stolen = "ble-0105";
constexpr std::chrono::seconds long_time{240};

json mesh_of(const GatewayProcess& gateway) {
  return json::parse(read_file(gateway / "store/mesh.json"), nullptr, false);
}

std::size_t nodes_with(const json& mesh, const char* member, const char* value) {
  const auto nodes = mesh.find("nodes");
  if (nodes == mesh.end()) return 0;
  return static_cast<std::size_t>(
      std::count_if(nodes->begin(), nodes->end(),
                    [&](const json& node) { return node.value(member, "") == value; }));
}

/// Returns the number of received messages by robot.
std::map<std::string, double> counts(const GatewayProcess& gateway) {
  std::map<std::string, double> all;
  for (const json& row : gateway.ctl({"robots"})) all[row["id"]] = row["messages"];
  return all;
}

/// Returns the number of robots with messages since `before`.
std::size_t heard_since(const GatewayProcess& gateway, std::map<std::string, double> before) {
  std::size_t heard = 0;
  for (const auto& [robot, count] : counts(gateway)) heard += count > before[robot] ? 1 : 0;
  return heard;
}

TEST(KeyRefreshOfAMesh, LosesNoRobotOnBadRadioAndOverKill) {
  Mosquitto broker;
  GatewayProcess gateway({{"broker", {{"uri", broker.uri()}}}, {"ble_mesh", {{"enabled", true}}}});
  const auto robots_with_loss = [&](const char* loss) {
    return std::vector<std::string>{"ble",
                                    "--tty",
                                    gateway.tty(),
                                    "--unprovisioned",
                                    "--robots",
                                    std::to_string(mesh_size),
                                    "--rate",
                                    "1",
                                    "--acknowledged",
                                    "--loss",
                                    loss,
                                    "--state",
                                    gateway / "robots.json"};
  };
  {
    SimulatorProcess good_radio(robots_with_loss("0"));
    const auto are_configured = [&] {
      return nodes_with(mesh_of(gateway), "state", "configured") == mesh_size;
    };
    ASSERT_TRUE(eventually(are_configured, long_time)) << gateway.log();
    good_radio.process().send_signal(SIGTERM);
    good_radio.report();
  }
  SimulatorProcess simulator(robots_with_loss("0.1"));
  const json old_mesh = mesh_of(gateway);

  const json begun = gateway.ctl({"ble", "refresh-keys", "--leave-behind", stolen, "--yes"});
  ASSERT_EQ(begun["robots"], mesh_size - 1) << begun << gateway.log();
  const auto has_begun = [&] {
    const json mesh = mesh_of(gateway);
    const bool is_over = mesh.is_object() && !mesh.contains("refresh");
    return is_over || nodes_with(mesh, "refreshed", "distributing") > 3 ||
           nodes_with(mesh, "refreshed", "switching") > 0;
  };
  ASSERT_TRUE(eventually(has_begun, long_time)) << gateway.log();
  gateway.process().send_signal(SIGKILL);
  gateway.process().wait();
  gateway.start();
  const auto is_over = [&] {
    const json status = gateway.ctl({"ble", "refresh-keys", "--status"});
    return status.is_object() && status["step"] == "none";
  };
  ASSERT_TRUE(eventually(is_over, long_time)) << gateway.log();

  json mesh;  // the file follows the status
  const auto is_written = [&] {
    mesh = mesh_of(gateway);
    return mesh.is_object() && !mesh.contains("refresh");
  };
  ASSERT_TRUE(eventually(is_written, long_time)) << mesh;
  EXPECT_NE(mesh["net_key"], old_mesh["net_key"]);
  EXPECT_NE(mesh["app_key"], old_mesh["app_key"]);
  EXPECT_EQ(mesh["nodes"].size(), mesh_size - 1);
  const auto before = counts(gateway);
  EXPECT_TRUE(eventually([&] { return heard_since(gateway, before) == mesh_size - 1; }, long_time))
      << gateway.ctl({"robots"});
  const auto now = counts(gateway);
  EXPECT_EQ(now.contains(stolen) ? now.at(stolen) : 0,
            before.contains(stolen) ? before.at(stolen) : 0)
      << "a robot with the old keys is excluded";
  EXPECT_EQ(gateway.ctl({"send", "ble-0100", "cmd", "10,-20"})["outcome"], "delivered");
  for (const json& shown : {old_mesh, mesh})
    for (const char* const key : {"net_key", "app_key"})
      EXPECT_FALSE(gateway.logs(shown[key].get<std::string>()));
}

}  // namespace
}  // namespace slamgw::test
