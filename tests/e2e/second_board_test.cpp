// SPDX-License-Identifier: Apache-2.0
// A second gateway joins a BLE mesh: the steps of docs/fleet.md, "Several boards in one BLE mesh",
// one after the other as an operator does them, with two simulated boards on one Mosquitto.
#include <gtest/gtest.h>
#include <signal.h>

#include <filesystem>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

/// Returns `words` and expects them on the page, so that the test performs the page's commands.
std::string as_on_the_page(const std::string& words) {
  static const std::string page = read_file(SLAMGW_FLEET_PAGE);
  EXPECT_NE(page.find(words), std::string::npos) << "docs/fleet.md no longer says: " << words;
  return words;
}

class SecondBoard : public testing::Test {
 protected:
  static json configuration(const Mosquitto& broker, const std::string& id) {
    return {{"gateway", {{"id", id}}},
            {"broker", {{"uri", broker.uri()}}},
            {"ble_mesh", {{"provisioning", {{"enabled", false}}}}}};
  }
  static json with_board(const Mosquitto& broker) {
    json settings = configuration(broker, "first");
    settings["ble_mesh"]["enabled"] = true;
    return settings;
  }
  /// Runs `slam-gatewayctl COMMAND...` as an operator types it.
  static Finished type(const GatewayProcess& gateway, std::vector<std::string> command) {
    command.insert(command.begin(), {SLAMGW_CTL, "--socket", gateway / "control.sock"});
    return run_program(command);
  }
  static void restart(GatewayProcess& gateway) {
    gateway.process().send_signal(SIGTERM);
    EXPECT_EQ(gateway.process().wait(), 0) << gateway.log();
    gateway.start();
  }
  static bool is_board_up(const GatewayProcess& gateway) {
    const json status = gateway.ctl({"status"});
    return status.is_object() && status["meshes"]["ble"]["state"] == "up";
  }
  /// Returns the gateway that serves the robot in the view of all `gateways`; empty if they
  /// disagree.
  static std::string place_of(const std::string& robot,
                              const std::vector<const GatewayProcess*>& gateways) {
    std::set<std::string> places;
    for (const GatewayProcess* gateway : gateways) {
      const json fleet = gateway->ctl({"fleet"});
      if (!fleet.is_object()) return "";
      std::string place;
      for (const json& row : fleet["robots"])
        if (row["robot"] == robot && row["served"] == true) place = row["gateway"];
      places.insert(place);
    }
    return places.size() == 1 ? *places.begin() : "";
  }
  bool provision(const json& uuid, const std::string& robot) {
    return first.ctl({"ble", "provision", uuid, "--id", robot}).is_object();
  }
  std::string exported_to(const std::string& file, std::vector<std::string> more = {}) {
    std::vector<std::string> command{"ble", "export"};
    command.insert(command.end(), more.begin(), more.end());
    command.push_back(file);
    const Finished done = type(first, command);
    EXPECT_EQ(done.status, 0) << done.err;
    return done.out;
  }
  void kill_first() {
    first.process().send_signal(SIGKILL);
    first.process().wait();
  }

  Mosquitto broker;
  GatewayProcess first{with_board(broker)};
  GatewayProcess second{configuration(broker, "second")};
  TempDir directory;
  const std::string board_of_second = directory / "board";
  SimulatorProcess robots{{"ble", "--tty", first.tty() + "," + board_of_second, "--unprovisioned",
                           "--robots", "2", "--rate", "2", "--acknowledged", "--numbered"}};
};

TEST_F(SecondBoard, JoinsMeshByStepsOfManual) {
  ASSERT_TRUE(eventually([&] { return is_board_up(first); })) << first.log();
  const json found = first.ctl({"ble", "scan"});
  ASSERT_EQ(found.size(), 2U) << first.log();
  const std::string robot = "lego-1";
  ASSERT_TRUE(provision(found[0]["uuid"], robot)) << first.log();

  // 1. A group that robots publish to; the first gateway configures its robots automatically.
  const json group = json::parse(as_on_the_page(R"({"ble_mesh": {"gateway_group": "0xc010"}})"));
  first.configure([&](json& changed) { changed.merge_patch(group); });
  restart(first);
  as_on_the_page("publishes to 0xc010`");
  ASSERT_TRUE(eventually([&] { return first.logs("is reconfigured: it publishes to 0xc010"); }))
      << first.log();

  // 2. The file for the second gateway, and its address.
  const std::string file = directory / "mesh.export";
  as_on_the_page("On the first: `slam-gatewayctl ble export FILE`");
  const std::string said = exported_to(file);
  const std::size_t at = said.find("0x");
  ASSERT_NE(at, std::string::npos) << said;
  const std::string address = said.substr(at, 6);

  // 3. The second one's settings, before its board is plugged in.
  const json settings = json::parse(as_on_the_page(
      R"({"ble_mesh": {"enabled": true, "address": "0x0021", "gateway_group": "0xc010"}})"));
  EXPECT_EQ(settings["ble_mesh"]["address"], address) << said;
  second.configure([&](json& changed) { changed.merge_patch(settings); });
  restart(second);

  // 4. and 5. The import, and the board.
  as_on_the_page("`slam-gatewayctl ble import FILE`");
  ASSERT_TRUE(eventually([&] {
    return type(second, {"ble", "import", file}).status == 0;
  })) << type(second, {"ble", "import", file}).err;
  std::filesystem::create_symlink(board_of_second, second.tty());
  ASSERT_TRUE(eventually([&] { return is_board_up(second); })) << second.log();
  ASSERT_TRUE(eventually([&] {
    return !place_of(robot, {&first, &second}).empty();
  })) << first.log()
      << second.log();

  // Either board reaches the robot.
  const auto serves_alone = [&](const GatewayProcess& gateway, const std::string& id,
                                const std::string& which) {
    return place_of(which, {&gateway}) == id &&
           gateway.ctl({"send", which, "cmd", "10,-20"})["outcome"] == "delivered";
  };
  kill_first();
  EXPECT_TRUE(eventually([&] { return serves_alone(second, "second", robot); })) << second.log();
  first.start();
  ASSERT_TRUE(eventually([&] { return is_board_up(first); })) << first.log();

  // Only the first gateway provisions.
  for (const std::vector<std::string>& order :
       {std::vector<std::string>{"permit-join"}, {"remove", robot}, {"export", directory / "x"}}) {
    std::vector<std::string> command{"ble"};
    command.insert(command.end(), order.begin(), order.end());
    const Finished refused = type(second, command);
    EXPECT_NE(refused.status, 0) << order[0];
    EXPECT_NE(refused.err.find("'first' provisions this mesh"), std::string::npos) << refused.err;
  }

  // 6. A robot that joins later.
  const std::string newcomer = "lego-2";
  ASSERT_TRUE(provision(found[1]["uuid"], newcomer)) << first.log();
  ASSERT_TRUE(eventually([&] {
    return place_of(newcomer, {&first, &second}) == "first";
  })) << first.log()
      << second.log();
  EXPECT_TRUE(eventually([&] { return second.logs("ble export --address " + address); }))
      << second.log();
  as_on_the_page("`slam-gatewayctl ble export --address 0x0021 FILE` on the first");
  const std::string again = directory / "again.export";
  EXPECT_NE(exported_to(again, {"--address", address}).find(address), std::string::npos);
  const Finished imported = type(second, {"ble", "import", again});
  EXPECT_EQ(imported.status, 0) << imported.err;
  kill_first();
  EXPECT_TRUE(eventually([&] { return serves_alone(second, "second", newcomer); })) << second.log();
}

}  // namespace
}  // namespace slamgw::test
