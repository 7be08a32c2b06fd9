// SPDX-License-Identifier: Apache-2.0
// The JSON of `slam-gatewayctl --json status` and `robots`: people script against its names.
#include "daemon/app/status.hpp"

#include <nlohmann/json.hpp>

#include <gtest/gtest.h>

#include <set>

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

std::set<std::string> names(const json& object) {
  std::set<std::string> found;
  for (const auto& [name, value] : object.items()) found.insert(name);
  return found;
}

TEST(StatusJson, HasTheNamesThatPeopleScriptAgainst) {
  const json status = to_json(Status{});
  EXPECT_EQ(names(status),
            (std::set<std::string>{"broker", "commands", "configuration", "control", "fleet",
                                   "gateway", "memory_rss_bytes", "meshes", "messages", "queue",
                                   "retained", "robots", "store", "uptime_s", "version"}));
  EXPECT_EQ(names(status["broker"]),
            (std::set<std::string>{"missing_rights", "refused", "since", "state", "uri", "why"}));
  EXPECT_EQ(names(status["meshes"]), (std::set<std::string>{"ble", "thread"}));
  std::set<std::string> states;
  for (const Counter& count : counts_of(RobotRegistry{})) states.emplace(count.name);
  EXPECT_EQ(states, (std::set<std::string>{"asleep", "contested", "deaf", "known", "offline",
                                           "online", "untracked"}));
  EXPECT_TRUE(status["robots"].is_object());
  EXPECT_TRUE(status["control"].is_object());
  EXPECT_TRUE(status["fleet"].is_object());
}

TEST(StatusJson, ShowsStateOfEachLink) {
  Status status;
  status.broker = {"mqtt://b:1883", {false, WallTime{1'700'000'000s}, "refused"}, 0, {}, {}};
  status.meshes[Mesh::thread] = {true, true, "UDP [::]:47193", {{"received", 7}}};
  const json out = to_json(status);
  EXPECT_EQ(out["broker"], json::parse(R"({"state": "down", "uri": "mqtt://b:1883",
                                           "since": "2023-11-14T22:13:20Z", "why": "refused",
                                           "missing_rights": [],
                                           "refused": {"topics": 0, "list": []}})"));
  EXPECT_EQ(out["meshes"]["ble"]["state"], "disabled");
  json thread = out["meshes"]["thread"];
  thread.erase("latency");
  EXPECT_EQ(thread, json::parse(R"({"enabled": true, "state": "up",
                                "detail": "UDP [::]:47193", "counters": {"received": 7},
                                "messages": {"up": 0, "down": 0}})"));
  status.meshes[Mesh::thread].role = "leader";
  EXPECT_EQ(to_json(status)["meshes"]["thread"]["role"], "leader");
}

TEST(StatusJson, CountsLatenciesByBound) {
  Status status;
  EXPECT_FALSE(to_json(status)["meshes"]["ble"].contains("latency")) << "it is disabled";
  status.meshes[Mesh::ble].is_enabled = true;
  status.meshes[Mesh::ble].latency.add(700us);
  const json latency = to_json(status)["meshes"]["ble"]["latency"];
  EXPECT_EQ(latency["count"], 1);
  EXPECT_EQ(latency["sum_us"], 700);
  status.meshes[Mesh::ble].up = 2;
  status.meshes[Mesh::ble].down = 1;
  EXPECT_EQ(to_json(status)["meshes"]["ble"]["messages"], (json{{"up", 2}, {"down", 1}}));
  ASSERT_EQ(latency["buckets"].size(), LatencyHistogram::bounds_us.size());
  EXPECT_EQ(latency["buckets"][0], (json{{"le_us", 500}, {"count", 0}}));
  EXPECT_EQ(latency["buckets"][1], (json{{"le_us", 1000}, {"count", 1}}));
}

TEST(StatusJson, ShowsSizeOfDeadLetters) {
  Status status;
  status.store.dead_letters = 2;
  status.store.dead_letter_bytes = 99;
  EXPECT_EQ(to_json(status)["store"]["dead_letters"], 2);
  EXPECT_EQ(to_json(status)["store"]["dead_letter_bytes"], 99);
}

TEST(StatusJson, NamesRobotThatFilledStore) {
  Status status;
  EXPECT_TRUE(to_json(status)["store"]["largest"].is_null());
  status.store.largest = {"p/robot/r1", 7};
  EXPECT_EQ(to_json(status)["store"]["largest"], (json{{"robot", "r1"}, {"bytes", 7}}));
  EXPECT_TRUE(to_json(status)["store"]["filled_by"].is_null());
  status.store.is_nearly_full = true;
  EXPECT_EQ(to_json(status)["store"]["filled_by"], (json{{"robot", "r1"}, {"bytes", 7}}));
  for (const char* flow : {"p/fleet/robots", "p/robot/gateway/g", "robot"}) {
    status.store.largest = {flow, 7};
    EXPECT_EQ(to_json(status)["store"]["filled_by"], (json{{"robot", flow}, {"bytes", 7}}))
        << "not the flow of a robot";
  }
}

TEST(StatusJson, NamesAddressAndRobotThatUseMostPlacesAndRetainedTopics) {
  Status status;
  status.meshes[Mesh::thread].places = {100, 90, {"fd00::1", 50}, 0, {}};
  EXPECT_EQ(to_json(status)["meshes"]["thread"]["places"], json::parse(R"({"max": 100, "taken": 90,
                                     "most": {"address": "fd00::1", "clients": 50},
                                     "unproven": 0, "most_unproven": null})"));
  status.meshes[Mesh::thread].places = {100, 90, {"fd00::/64", 90}, 80, {"fd00::/64", 70}};
  EXPECT_EQ(to_json(status)["meshes"]["thread"]["places"]["most_unproven"],
            (json{{"address", "fd00::/64"}, {"clients", 70}}));
  EXPECT_FALSE(to_json(status)["meshes"]["ble"].contains("places"));
  EXPECT_TRUE(to_json(status)["retained"]["most"].is_null());
  status.retained = {20, "r1", 16};
  EXPECT_EQ(to_json(status)["retained"], json::parse(R"({"topics": 20, "max": 4096,
                                         "most": {"robot": "r1", "topics": 16}})"));
}

TEST(StatusJson, ShowsBrokerAsRefusingOnlyWhileItIsOnline) {
  Status status;
  status.broker = {"u",
                   {false, {}, "gone"},
                   2,
                   {{"commands may not come", "topic read p/server/#"}},
                   {{"t", {0x87, "not authorised"}, 3, 1, TimePoint{1s}}}};
  status.now = TimePoint{10s};
  EXPECT_EQ(to_json(status)["broker"]["state"], "down");
  EXPECT_EQ(to_json(status)["broker"]["why"], "gone");
  status.broker.link = {true, {}, {}};
  const json broker = to_json(status)["broker"];
  EXPECT_EQ(broker["state"], "refusing");
  EXPECT_EQ(broker["why"], "not authorised on t (3 messages wait), and 1 more topics");
  EXPECT_EQ(broker["missing_rights"][0]["grant"], "topic read p/server/#");
  EXPECT_EQ(broker["refused"], json::parse(R"({"topics": 2, "list": [{"topic": "t", "code": 135,
      "why": "not authorised", "waiting": 3, "tries": 1, "for_s": 9}]})"));
}

TEST(RobotRow, HasNullForUnknownValues) {
  Robot robot;
  robot.last_mesh = Mesh::ble;
  robot.on_mesh[Mesh::ble].presence = Presence::online;
  json row = robot_row("r", robot, {}, {});
  EXPECT_EQ(row["id"], "r");
  EXPECT_EQ(row["mesh"], "ble");
  EXPECT_EQ(row["state"], "online");
  EXPECT_TRUE(row["rssi_dbm"].is_null());
  EXPECT_TRUE(row["latency_p99_us"].is_null());
  EXPECT_EQ(row["deaf"], false);
  EXPECT_EQ(row["contested"], false);
  robot.radio = RadioFacts{-61, 2, 3};
  robot.radio_mesh = robot.mesh();
  row = robot_row("r", robot, {.queue = 5}, {});
  EXPECT_EQ(row["rssi_dbm"], -61);
  EXPECT_EQ(row["hops"], 2);
  EXPECT_EQ(row["ttl"], 3);
  EXPECT_EQ(row["queue"], 5);
  robot.is_session_contested = true;
  EXPECT_EQ(robot_row("r", robot, {}, {})["contested"], true);
}

TEST(RobotRow, ListsEachMeshOfTheRobot) {
  Robot robot;
  robot.last_mesh = Mesh::ble;
  EXPECT_EQ(robot_row("r", robot, {}, {})["meshes"], json::object());
  robot.on_mesh[Mesh::ble].is_known = true;
  robot.on_mesh[Mesh::ble].address = "0x0100";
  robot.on_mesh[Mesh::thread].presence = Presence::online;
  robot.on_mesh[Mesh::thread].address = "[fd00::1]:47193";
  robot.on_mesh[Mesh::thread].up = 7;
  EXPECT_EQ(robot_row("r", robot, {}, {})["meshes"], json::parse(R"({
      "ble": {"address": "0x0100", "state": "offline", "messages": 0, "commands": 0, "repeats": 0},
      "thread": {"address": "[fd00::1]:47193", "state": "online", "messages": 7, "commands": 0,
                 "repeats": 0}})"));
}

TEST(WhyAbsent, NamesMostSpecificReason) {
  Robot robot;
  robot.last_mesh = Mesh::thread;
  MeshPresence& thread = robot.on_mesh[Mesh::thread];
  thread.presence = Presence::online;
  RobotSurroundings around{.link = {true, true, "UDP", {}}, .offline_after = 30s};
  EXPECT_EQ(why_absent(robot, around), "");
  thread.is_deaf = true;
  EXPECT_NE(why_absent(robot, around).find("does not hear the gateway"), std::string::npos);
  thread.is_contested = true;
  EXPECT_NE(why_absent(robot, around).find("another client uses its name"), std::string::npos);
  thread.is_contested = thread.is_deaf = false;
  thread.presence = Presence::offline;
  thread.since = WallTime{1'700'000'000s};
  EXPECT_EQ(why_absent(robot, around), "not heard since the daemon started");
  robot.last_seen = thread.since - 300ms;
  EXPECT_NE(why_absent(robot, around).find("disconnected (DISCONNECT)"), std::string::npos);
  EXPECT_NE(why_absent(robot, around).find("or lost its address to another"), std::string::npos);
  robot.last_seen = thread.since - 90s;
  EXPECT_NE(why_absent(robot, around).find("meant to sleep, ran out after 90 s"),
            std::string::npos);
  robot.last_mesh = Mesh::ble;
  robot.on_mesh[Mesh::ble].since = thread.since;
  EXPECT_NE(why_absent(robot, around).find("not heard it for 90 s"), std::string::npos);
  robot.last_seen = thread.since - 29500ms;
  EXPECT_NE(why_absent(robot, around).find("not heard it for 29 s"), std::string::npos);
  robot.last_seen = thread.since - 12s;
  EXPECT_EQ(why_absent(robot, around), "it was removed from the mesh, or renamed");
  around.is_banned = true;
  EXPECT_EQ(why_absent(robot, around), "it is banned (slam-gatewayctl unban)");
  around = {.link = {true, false, "no board", {}}};
  EXPECT_EQ(why_absent(robot, around), "the ble link is down: no board");
}

}  // namespace
}  // namespace slamgw
