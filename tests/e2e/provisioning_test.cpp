// SPDX-License-Identifier: Apache-2.0
// A fresh board and new robots: they join the mesh without a command, also when the daemon is
// killed while they join. Operators provision and remove them by command.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <set>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr int robot_count = 10;
/// Longest time for ten robots to join; they usually need a quarter of it.
constexpr std::chrono::seconds join_limit{60};

json configuration(const Mosquitto& broker, bool is_automatic = true) {
  return {{"broker", {{"uri", broker.uri()}}},
          {"ble_mesh", {{"enabled", true}, {"provisioning", {{"enabled", is_automatic}}}}}};
}

std::vector<std::string> new_robots(const GatewayProcess& gateway, int count) {
  return {"ble",    "--tty", gateway.tty(), "--unprovisioned", "--robots", std::to_string(count),
          "--rate", "2"};
}

bool all_publish(const Subscriber& subscriber, std::size_t count) {
  std::set<std::string> topics;
  for (const std::string& line : subscriber.lines()) topics.insert(line.substr(0, line.find(' ')));
  return topics.size() == count;
}

std::size_t count_of(const std::string& text, const std::string& what) {
  std::size_t count = 0;
  for (auto at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++count;
  return count;
}

TEST(NewRobots, JoinAutomaticallyAndTakeCommands) {
  Mosquitto broker;
  Subscriber updates(broker, "ntnu-slam/robot/+/update");
  GatewayProcess gateway(configuration(broker));
  SimulatorProcess simulator(new_robots(gateway, robot_count));
  ASSERT_TRUE(eventually([&] { return all_publish(updates, robot_count); }, join_limit))
      << gateway.log();
  const json rows = gateway.ctl({"robots"});
  ASSERT_EQ(rows.size(), static_cast<std::size_t>(robot_count));
  for (const json& row : rows) {
    EXPECT_EQ(row["state"], "online") << row;
    EXPECT_TRUE(row["rssi_dbm"].is_number()) << row;
    const std::string id = row["id"];
    EXPECT_EQ(gateway.ctl({"send", id, "cmd", "10,-20"})["outcome"], "delivered") << id;
    EXPECT_EQ(gateway.ctl({"send", id, "run", "stop"})["outcome"], "delivered") << id;
  }
  const std::string keys = read_file(gateway / "store/mesh.json");
  const json mesh = json::parse(keys);
  EXPECT_FALSE(gateway.logs(mesh["net_key"]) || gateway.logs(mesh["nodes"][0]["device_key"]));
  simulator.process().send_signal(SIGTERM);
  EXPECT_EQ(simulator.report()["commands_received"], 2 * robot_count);
}

TEST(NewRobots, AnswerPingsAndTakeTheirOwnConfiguration) {
  Mosquitto broker;
  GatewayProcess gateway(configuration(broker));
  SimulatorProcess simulator(new_robots(gateway, 1));
  ASSERT_TRUE(eventually([&] { return gateway.logs("is configured"); }, join_limit))
      << gateway.log();
  const std::string id = gateway.ctl({"ble", "nodes"})[0]["robot"];
  const json ping = gateway.ctl({"ping", id});
  EXPECT_EQ(ping["answered"], true) << ping;
  EXPECT_TRUE(ping["hops"].is_number()) << ping;
  const json before = gateway.ctl({"ble", "config", id});
  EXPECT_EQ(before["wanted"], json::object()) << before;
  EXPECT_GE(before["models"].size(), 3U) << before;
  const json after =
      gateway.ctl({"ble", "config", id, "--ttl", "9", "--relay", "off", "--transmit", "2x30"});
  EXPECT_EQ(after["ttl"], 9) << after;
  EXPECT_EQ(after["relay"]["state"], "off") << after;
  EXPECT_EQ(after["transmit"], (json{{"sends", 2}, {"interval_ms", 30}})) << after;
  EXPECT_EQ(json::parse(read_file(gateway / "store/mesh.json"))["nodes"][0]["wanted"]["ttl"], 9);
  EXPECT_EQ(gateway.ctl({"send", id, "cmd", "10,-20"})["outcome"], "delivered");
}

TEST(Commands, TimeOutWhenDaemonStopsBeforeRobotAnswers) {
  Mosquitto broker;
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/ghost", "%p");
  json settings = configuration(broker, /*is_automatic=*/false);  // no robot gets its address
  settings["robots"] = {{{"id", "ghost"}, {"ble_address", "0x0300"}}};
  GatewayProcess gateway(settings);
  SimulatorProcess simulator(new_robots(gateway, 1));
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble link up"); })) << gateway.log();
  ASSERT_TRUE(eventually([&] { return gateway.ctl({"status"})["fleet"]["sessions"] == 1; }));
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/ghost/run", "-m", "stop"});
  ASSERT_TRUE(eventually([&] {
    const json status = gateway.ctl({"status"});
    return status["meshes"]["ble"]["counters"]["sent"] > 0;
  })) << gateway.ctl({"status"});
  gateway.process().send_signal(SIGTERM);
  ASSERT_TRUE(eventually([&] { return !outcomes.lines().empty(); })) << gateway.log();
  const json outcome = json::parse(outcomes.lines()[0]);
  EXPECT_EQ(outcome["outcome"], "timeout") << "the command was sent";
  EXPECT_EQ(outcome["why"], "the gateway is stopping");
}

TEST(NewRobots, JoinAlthoughDaemonIsKilledDuringProvisioning) {
  Mosquitto broker;
  GatewayProcess gateway(configuration(broker));
  SimulatorProcess simulator(new_robots(gateway, robot_count));
  // Kills just after a robot's key was stored. A kill before the key is stored makes a manual reset
  // of the robot necessary.
  ASSERT_TRUE(eventually([&] {
    return count_of(read_file(gateway / "store/mesh.json"), "device_key") >= 3;
  })) << gateway.log();
  gateway.process().send_signal(SIGKILL);
  gateway.process().wait();
  gateway.start();
  Subscriber updates(broker, "ntnu-slam/robot/+/update");
  ASSERT_TRUE(eventually([&] { return all_publish(updates, robot_count); }, join_limit))
      << gateway.log() << gateway.ctl({"ble", "nodes"});
  std::set<std::string> addresses;
  for (const json& node : gateway.ctl({"ble", "nodes"})) addresses.insert(node["address"]);
  EXPECT_EQ(addresses.size(), static_cast<std::size_t>(robot_count));
}

TEST(NewRobots, AreReconfiguredAfterSettingsChange) {
  constexpr std::size_t count = 3;
  Mosquitto broker;
  GatewayProcess gateway(configuration(broker));
  const std::string state_file = gateway / "state.json";
  std::vector<std::string> arguments = new_robots(gateway, static_cast<int>(count));
  arguments.insert(arguments.end(), {"--state", state_file});
  SimulatorProcess simulator(arguments);
  ASSERT_TRUE(
      eventually([&] { return count_of(gateway.log(), "is configured") == count; }, join_limit))
      << gateway.log();
  gateway.process().send_signal(SIGTERM);
  gateway.process().wait();
  gateway.configure([](json& changed) {
    changed["ble_mesh"]["ttl"] = 8;
    changed["ble_mesh"]["groups"] = {"0xc002", "0xc005"};
  });
  gateway.start();
  const std::string news = "is reconfigured: its TTL is 8; its groups are 0xc002, 0xc005";
  ASSERT_TRUE(eventually([&] { return count_of(gateway.log(), news) == count; }, join_limit))
      << gateway.log();

  Subscriber updates(broker, "ntnu-slam/robot/+/update");
  EXPECT_TRUE(eventually([&] { return all_publish(updates, count); })) << gateway.log();
  for (const json& node : gateway.ctl({"ble", "nodes"}))
    EXPECT_TRUE(node["state"] == "configured" && node["problem"] == "") << node;
  for (const json& row : gateway.ctl({"robots"})) {
    EXPECT_TRUE(row["ttl"] == 8 && row["hops"] == 0) << row;
    EXPECT_EQ(gateway.ctl({"send", row["id"], "cmd", "10,-20"})["outcome"], "delivered") << row;
  }
  simulator.process().send_signal(SIGTERM);
  EXPECT_EQ(simulator.report()["commands_received"], count);
  const json state = json::parse(read_file(state_file));
  std::size_t subscribed = 0;
  for (const json& node : state["nodes"]) {
    for (const json& model : node["models"]) {
      if (model["subscriptions"].empty()) continue;
      EXPECT_EQ(model["subscriptions"], (json{0xc002, 0xc005})) << model;
      ++subscribed;
    }
  }
  EXPECT_GT(subscribed, count);
}

TEST(NewRobots, JoinAndLeaveByCommand) {
  Mosquitto broker;
  GatewayProcess gateway(configuration(broker, false));
  SimulatorProcess simulator(new_robots(gateway, 2));
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble link up"); })) << gateway.log();
  const json found = gateway.ctl({"ble", "scan"});
  ASSERT_EQ(found.size(), 2u) << found;
  Subscriber updates(broker, "ntnu-slam/robot/lego-1/update");
  const json joined = gateway.ctl({"ble", "provision", found[0]["uuid"], "--id", "lego-1"});
  ASSERT_TRUE(joined.is_object()) << gateway.log();
  EXPECT_EQ(joined["state"], "configured") << joined;
  EXPECT_TRUE(eventually([&] { return !updates.lines().empty(); })) << gateway.log();
  EXPECT_EQ(gateway.ctl({"ble", "remove", "lego-1"})["robot"], "lego-1") << gateway.log();
  EXPECT_EQ(gateway.ctl({"ble", "nodes"}), json::array());
}

// --- By a request at the broker, as the live page sends it ---------------------------------------

constexpr const char* request_topic = "ntnu-slam/gateway/test/request/permit_join";
constexpr const char* responses = "ntnu-slam/gateway/+/response/permit_join";

json closed_mesh(const Mosquitto& broker, bool takes_requests = true) {
  return {
      {"broker", {{"uri", broker.uri()}}},
      {"ble_mesh",
       {{"enabled", true}, {"provisioning", {{"enabled", false}, {"over_mqtt", takes_requests}}}}}};
}

void request(const Mosquitto& broker, const std::string& payload,
             const std::string& topic = request_topic) {
  mosquitto_publish(broker, {"-V", "5", "-q", "1", "-t", topic, "-m", payload, "-D", "publish",
                             "user-property", "sender", "ada"});
}

bool has(const Subscriber& subscriber, const std::string& text) {
  const auto lines = subscriber.lines();
  return std::ranges::any_of(
      lines, [&](const std::string& line) { return line.find(text) != std::string::npos; });
}
bool gets(const Subscriber& subscriber, const std::string& text) {
  return eventually([&] { return has(subscriber, text); });
}

class JoinRequest : public testing::TestWithParam<const char*> {};

TEST_P(JoinRequest, ProvisionsRobotUnderRequestedName) {
  Mosquitto broker;
  Subscriber answers(broker, responses, "%p");
  Subscriber presence(broker, "ntnu-slam/gateway/test/robots/lego-1");
  json settings = closed_mesh(broker);
  settings["broker"]["client"] = GetParam();
  GatewayProcess gateway(settings);
  SimulatorProcess simulator(
      {"ble", "--tty", gateway.tty(), "--unprovisioned", "--robots", "1", "--rate", "2"});
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble link up"); }, join_limit));
  request(broker, R"({"seconds": 90, "name": "lego-1"})");
  ASSERT_TRUE(eventually([&] { return !presence.lines().empty(); }, join_limit)) << gateway.log();
  ASSERT_TRUE(gets(answers, R"("event":"configured")")) << gateway.log();
  const json end = json::parse(answers.lines().back());
  EXPECT_EQ(end["under_way"], 0);
  EXPECT_EQ(end["seconds_left"], 0);  // the named robot has joined
  ASSERT_EQ(end["events"].size(), 3U) << end;
  EXPECT_EQ(end["events"][2]["event"], "configured");
  EXPECT_EQ(end["events"][2]["robot"], "lego-1");
  EXPECT_EQ(json::parse(answers.lines().front())["seconds_left"], 90);
  EXPECT_TRUE(gateway.logs("ble permit-join 90 s lego-1: done; asked by broker: ada"))
      << gateway.log();
  EXPECT_EQ(gateway.ctl({"status"})["meshes"]["ble"]["counters"]["join_requests"], 1);
  request(broker, R"({"seconds": 90, "name": "lego-1"})");
  EXPECT_TRUE(gets(answers, "lego-1 is another robot already"));
}

INSTANTIATE_TEST_SUITE_P(With, JoinRequest, testing::Values("paho", "mosquitto"),
                         [](const auto& client) { return std::string(client.param); });

TEST(JoinRequests, PublishPermitOfOperator) {
  Mosquitto broker;
  Subscriber answers(broker, responses, "%p");
  GatewayProcess gateway(closed_mesh(broker));
  SimulatorProcess simulator({"ble", "--tty", gateway.tty(), "--unprovisioned", "--robots", "1"});
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble link up"); }, join_limit));
  gateway.ctl({"ble", "permit-join", "--minutes", "0"});
  EXPECT_TRUE(gets(answers, R"("seconds_left":0)")) << gateway.log();
  EXPECT_TRUE(gateway.logs("ble permit-join closed: done; asked by uid")) << gateway.log();
}

TEST(JoinRequests, AreRefusedWithReasonWithoutBoardOrMesh) {
  Mosquitto broker;
  Subscriber answers(broker, responses, "%t %p");
  GatewayProcess gateway(closed_mesh(broker));
  json settings = closed_mesh(broker);
  settings["gateway"]["id"] = "other";
  settings["ble_mesh"]["enabled"] = false;
  GatewayProcess other(settings);
  ASSERT_TRUE(eventually(
      [&] { return gateway.logs("connected (MQTT 5)") && other.logs("connected (MQTT 5)"); }));
  // A gateway may subscribe a moment after it is connected.
  EXPECT_TRUE(eventually([&] {
    request(broker, R"({"seconds": 60})", "ntnu-slam/gateway/other/request/permit_join");
    return has(answers, "other/response/permit_join {\"error\":\"the BLE mesh is not enabled");
  }));
  EXPECT_FALSE(has(answers, "test/response"));
  EXPECT_TRUE(eventually([&] {
    request(broker, R"({"seconds": 60})");
    return has(answers, "test/response/permit_join {\"error\":\"the BLE link is down");
  }));
  EXPECT_TRUE(eventually([&] {  // one request a second is accepted
    request(broker, "let them in");
    return has(answers, "a request must be");
  }));
  EXPECT_GE(gateway.ctl({"status"})["meshes"]["ble"]["counters"]["join_requests_refused"], 1);
}

TEST(JoinRequests, AreRefusedWhenRetained) {
  Mosquitto broker;
  mosquitto_publish(broker, {"-r", "-q", "1", "-t", request_topic, "-m", R"({"seconds": 60})"});
  Subscriber answers(broker, responses, "%p");
  GatewayProcess gateway(closed_mesh(broker));
  EXPECT_TRUE(gets(answers, "the request is retained"));
  EXPECT_TRUE(gateway.logs("a request to let robots join was refused: the request is retained"));
  EXPECT_FALSE(gateway.logs("permit-join"));
}

TEST(JoinRequests, AreIgnoredUnlessConfigured) {
  Mosquitto broker;
  Subscriber answers(broker, responses, "%p");
  GatewayProcess gateway(closed_mesh(broker, /*takes_requests=*/false));
  ASSERT_TRUE(eventually([&] { return gateway.logs("connected (MQTT 5)"); }));
  // The command comes after the request, so its outcome shows that a request would have come, too.
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/ghost");
  ASSERT_TRUE(eventually([&] {  // the gateway may subscribe a moment after it is connected
    request(broker, R"({"seconds": 60})");
    mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/ghost/run", "-m", "stop"});
    return !outcomes.lines().empty();
  })) << gateway.log();
  EXPECT_TRUE(answers.lines().empty());
  EXPECT_FALSE(gateway.ctl({"status"})["meshes"]["ble"]["counters"].contains("join_requests"));
}

}  // namespace
}  // namespace slamgw::test
