// SPDX-License-Identifier: Apache-2.0
// The JSON of `slam-gatewayctl --json status` and `robots`: people script against its names.
#include "daemon/app/status.hpp"

#include <nlohmann/json.hpp>

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

TEST(StatusJson, ShowsStateOfEachLink) {
  EXPECT_EQ(broker_json("mqtt://b:1883", {false, WallTime{1'700'000'000s}, "refused"}, {}, {}, {}),
            json::parse(R"({"state": "down", "uri": "mqtt://b:1883",
                            "since": "2023-11-14T22:13:20Z", "why": "refused",
                            "missing_rights": [], "refused": {"topics": 0, "list": []}})"));
  EXPECT_EQ(to_json(MeshLink{})["state"], "disabled");
  MeshLink link{true, true, "UDP [::]:47193", {{"received", 7}}};
  json thread = to_json(link);
  thread.erase("latency");
  EXPECT_EQ(thread, json::parse(R"({"enabled": true, "state": "up",
                                "detail": "UDP [::]:47193", "counters": {"received": 7},
                                "messages": {"up": 0, "down": 0}})"));
  link.role = "leader";
  EXPECT_EQ(to_json(link)["role"], "leader");
}

TEST(StatusJson, CountsLatenciesByBound) {
  MeshLink link;
  EXPECT_FALSE(to_json(link).contains("latency")) << "it is disabled";
  link.is_enabled = true;
  link.latency.add(700us);
  const json latency = to_json(link)["latency"];
  EXPECT_EQ(latency["count"], 1);
  EXPECT_EQ(latency["sum_us"], 700);
  link.up = 2;
  link.down = 1;
  EXPECT_EQ(to_json(link)["messages"], (json{{"up", 2}, {"down", 1}}));
  ASSERT_EQ(latency["buckets"].size(), LatencyHistogram::bounds_us.size());
  EXPECT_EQ(latency["buckets"][0], (json{{"le_us", 500}, {"count", 0}}));
  EXPECT_EQ(latency["buckets"][1], (json{{"le_us", 1000}, {"count", 1}}));
}

/// Returns the status of a store of 100 bytes that this process finds.
json status_of_store(StoreOpened found) {
  Outbox outbox(1, 100);
  outbox.on_store_event(std::move(found), {});
  return store_json(outbox, 100, {});
}

TEST(StatusJson, ShowsSizeOfDeadLetters) {
  StoreOpened found;
  found.dead_letters = {2, 99};
  const json store = status_of_store(found);
  EXPECT_EQ(store["state"], "working");
  EXPECT_EQ(store["max_bytes"], 100);
  EXPECT_EQ(store["dead_letters"], 2);
  EXPECT_EQ(store["dead_letter_bytes"], 99);
  EXPECT_EQ(store["dead_letters_nearly_full"], true);
}

TEST(StatusJson, NamesRobotThatFilledStore) {
  EXPECT_TRUE(status_of_store({})["largest"].is_null());
  StoreOpened found;
  found.count = 1;
  found.bytes = 7;
  found.shares.add_named("p/robot/r1", 7);
  EXPECT_EQ(status_of_store(found)["largest"], (json{{"robot", "r1"}, {"bytes", 7}}));
  EXPECT_TRUE(status_of_store(found)["filled_by"].is_null());
  found.bytes = 90;
  EXPECT_TRUE(status_of_store(found)["filled_by"].is_null()) << "it has not stored half of it";
  found.shares.add_named("p/robot/r1", 50);
  EXPECT_EQ(status_of_store(found)["filled_by"], (json{{"robot", "r1"}, {"bytes", 57}}));
  for (const char* flow : {"p/fleet/robots", "p/robot/gateway/g", "robot"}) {
    found.shares = {};
    found.shares.add_named(flow, 57);
    EXPECT_EQ(status_of_store(found)["filled_by"], (json{{"robot", flow}, {"bytes", 57}}))
        << "not the flow of a robot";
  }
}

TEST(StatusJson, NamesAddressAndRobotThatUseMostPlacesAndRetainedTopics) {
  MeshLink thread;
  EXPECT_FALSE(to_json(thread).contains("places"));
  thread.places = {100, 90, {"fd00::1", 50}, 0, {}};
  EXPECT_EQ(to_json(thread)["places"], json::parse(R"({"max": 100, "taken": 90,
                                     "most": {"address": "fd00::1", "clients": 50},
                                     "unproven": 0, "most_unproven": null})"));
  thread.places = {100, 90, {"fd00::/64", 90}, 80, {"fd00::/64", 70}};
  EXPECT_EQ(to_json(thread)["places"]["most_unproven"],
            (json{{"address", "fd00::/64"}, {"clients", 70}}));
  RetainedTopics retained;
  EXPECT_TRUE(retained_json(retained)["most"].is_null());
  for (const char* const topic : {"a", "b"}) retained.admit("r1", topic, false);
  retained.admit("r2", "c", false);
  EXPECT_EQ(retained_json(retained), json::parse(R"({"topics": 3, "max": 4096,
                                         "most": {"robot": "r1", "topics": 2}})"));
}

TEST(StatusJson, ShowsBrokerAsRefusingOnlyWhileItIsOnline) {
  const RefusedSummary refused{2, {{"t", {0x87, "not authorised"}, 3, 1, TimePoint{1s}}}};
  const std::vector<MissingRight> missing{{"commands may not come", "topic read p/server/#"}};
  json broker = broker_json("u", {false, {}, "gone"}, refused, missing, TimePoint{10s});
  EXPECT_EQ(broker["state"], "down");
  EXPECT_EQ(broker["why"], "gone");
  broker = broker_json("u", {true, {}, {}}, refused, missing, TimePoint{10s});
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
  robot.on_mesh[robot.mesh()].radio = RadioFacts{-61, 2, 3};
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
