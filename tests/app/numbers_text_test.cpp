// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/numbers_text.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace {

using namespace slamgw;
using namespace std::chrono_literals;
using nlohmann::json;

const TimePoint now{1h};

json read(const std::map<std::string, Robot>& robots) {
  return json::parse(numbers_text(robots, now));
}

TEST(NumbersText, MatchesDocumentedExample) {
  std::map<std::string, Robot> robots;
  Robot& robot = robots["r"];
  robot.last_seen = WallTime{1'700'000'000s};
  robot.last_mesh = Mesh::ble;
  robot.on_mesh[Mesh::ble].up = 6;
  robot.on_mesh[Mesh::thread].up = 1;
  robot.on_mesh[Mesh::thread].down = 2;
  robot.on_mesh[Mesh::thread].repeats = 1;
  for (int i = 0; i < 7; ++i) robot.numbers.on_up(9, now);
  for (int i = 0; i < 2; ++i) robot.numbers.on_down(4);
  robot.numbers.on_repeat();
  EXPECT_EQ(read(robots), json::parse(R"({"robots": {"r": {"up": 7, "down": 2,
      "repeats": 1, "gaps": 0, "rate_hz": 1.4, "latency_p50_us": null, "latency_p99_us": null,
      "rssi_dbm": null, "hops": null, "ttl": null, "last_heard": "2023-11-14T22:13:20Z", "mesh": "ble",
      "meshes": {"ble": {"up": 6, "down": 0, "repeats": 0},
                 "thread": {"up": 1, "down": 2, "repeats": 1}}}}})"));
  for (int i = 0; i < 98; ++i) robot.numbers.on_safe(1500us, now);
  for (int i = 0; i < 2; ++i) robot.numbers.on_safe(9ms, now);
  robot.on_mesh[robot.mesh()].radio = RadioFacts{-61, 2, 3};
  const json row = read(robots)["robots"]["r"];
  EXPECT_EQ(row["latency_p50_us"], 1500);
  EXPECT_EQ(row["latency_p99_us"], 9000);
  EXPECT_EQ(row["rssi_dbm"], -61);
  EXPECT_EQ(row["hops"], 2);
  EXPECT_EQ(row["ttl"], 3);
}

TEST(NumbersText, RoundsRatesToHundredths) {
  std::map<std::string, Robot> robots;
  for (int i = 0; i < 3; ++i) robots["r"].numbers.on_up(9, now - 2500ms);
  EXPECT_EQ(read(robots)["robots"]["r"]["rate_hz"], 0.4);  // in 7.5 s
  robots["r"].numbers.on_up(9, now - 2500ms);
  EXPECT_EQ(read(robots)["robots"]["r"]["rate_hz"], 0.53);
}

TEST(NumbersText, IsValidJsonForAnyRobotName) {
  for (const std::string id : {"say \"hi\"\\\xc3\xb8", "a\nb", "\xe2\x80\xae", "a b~"}) {
    const std::map<std::string, Robot> robots{{id, Robot()}, {"z", Robot()}};
    const json rows = read(robots)["robots"];
    EXPECT_TRUE(rows.contains(id)) << id;
    EXPECT_TRUE(rows.contains("z")) << id;
  }
  EXPECT_EQ(read({{"not \xff UTF-8", Robot()}})["robots"].size(), 1);
  EXPECT_EQ(read({}), json::parse(R"({"robots": {}})"));
}

TEST(NumbersText, EscapesDirectionMarks) {
  const std::map<std::string, Robot> robots{{"a\xe2\x80\xae", Robot()}};
  const Bytes text = numbers_text(robots, now);
  EXPECT_NE(as_text(text).find(R"("a\u202e":)"), std::string::npos) << as_text(text);
}

TEST(NumbersText, IsBoundedAndKeepsRobotsHeardLast) {
  std::map<std::string, Robot> robots;
  for (std::size_t i = 0; i < max_robots_in_numbers + 3; ++i)
    robots[std::to_string(i)].last_seen = WallTime{std::chrono::seconds(i)};
  const json numbers = read(robots);
  EXPECT_EQ(numbers["robots"].size(), max_robots_in_numbers);
  EXPECT_EQ(numbers["left_out"], 3);
  for (const char* gone : {"0", "1", "2"}) EXPECT_FALSE(numbers["robots"].contains(gone));
  EXPECT_TRUE(numbers["robots"].contains(std::to_string(max_robots_in_numbers + 2)));
}

}  // namespace
