// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_registry.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

Report report_of(const std::string& robot, Mesh mesh) {
  return {.mesh = mesh, .robot = robot, .topic = {}, .payload = {}, .receipt = no_receipt};
}

TEST(RobotRegistry, ShowsTheMeshWhereARobotIsOnline) {
  RobotRegistry registry;
  registry.on_presence({Mesh::ble, "a", Presence::online, "0x0100"}, {});
  registry.on_presence({Mesh::thread, "a", Presence::online, "[::1]:5"}, {});
  registry.on_presence({Mesh::thread, "a", Presence::offline, "[::1]:5"}, {});
  const Robot* robot = registry.find("a");
  ASSERT_TRUE(robot);
  EXPECT_EQ(robot->mesh(), Mesh::ble);
  EXPECT_EQ(robot->presence().address, "0x0100");
}

TEST(RobotRegistry, NamesTheLastMeshOfARobotThatIsGone) {
  RobotRegistry registry;
  registry.on_presence({Mesh::ble, "a", Presence::offline, "0x0100"}, {});
  registry.on_presence({Mesh::thread, "a", Presence::offline, "[::1]:5"}, {});
  EXPECT_EQ(registry.find("a")->mesh(), Mesh::thread);
}

TEST(RobotRegistry, ShowsARobotWithoutAnAddressWhereItWasLast) {
  RobotRegistry registry;
  registry.on_presence({Mesh::thread, "a", Presence::online, "[::1]:5"}, {});
  registry.on_presence({Mesh::thread, "a", Presence::offline, ""}, {});
  EXPECT_EQ(registry.find("a")->presence().address, "[::1]:5");
}

TEST(RobotRegistry, CountsRobotsByTheirPresenceOnAllMeshes) {
  RobotRegistry registry;
  registry.on_report(report_of("heard", Mesh::thread), {});
  registry.on_presence({Mesh::ble, "a", Presence::online, ""}, {});
  registry.on_presence({Mesh::thread, "a", Presence::offline, ""}, {});
  registry.on_presence({Mesh::thread, "b", Presence::asleep, ""}, {});
  EXPECT_EQ(registry.count(Presence::online), 1u);
  EXPECT_EQ(registry.count(Presence::asleep), 1u);
  EXPECT_EQ(registry.count(Presence::offline), 1u);
  registry.on_presence({Mesh::ble, "a", Presence::offline, ""}, {});
  EXPECT_EQ(registry.count(Presence::online), 0u);
  EXPECT_EQ(registry.count(Presence::offline), 2u);
}

TEST(RobotRegistry, LastWillDoesNotCountAsASignOfLife) {
  RobotRegistry registry;
  const Now early{TimePoint{1s}, WallTime{100s}};
  const Now late{TimePoint{61s}, WallTime{160s}};
  registry.on_report(report_of("a", Mesh::thread), early);
  Report will = report_of("a", Mesh::thread);
  will.is_will = true;
  registry.on_report(will, late);
  registry.on_presence({Mesh::thread, "a", Presence::offline, ""}, late);
  EXPECT_EQ(registry.find("a")->last_seen, early.wall);
  registry.on_sign_of_life("a", Mesh::thread, late);
  registry.on_sign_of_life("unknown", Mesh::thread, late);
  EXPECT_EQ(registry.find("a")->last_seen, late.wall);
  EXPECT_FALSE(registry.find("unknown"));
  EXPECT_EQ(registry.find("a")->numbers.up(), 1u);
}

/// Reports a message each 10 s between these seconds.
void hear(RobotRegistry& registry, const std::string& robot, int from_s, int to_s) {
  for (int second = from_s; second <= to_s; second += 10)
    registry.on_report(report_of(robot, Mesh::thread), {TimePoint{1h} + 1s * second, {}});
}

TEST(RobotRegistry, EvictsOnlyStrangersForACrowdOfStrangers) {
  RobotRegistry registry(100);
  registry.set_configured({"configured"});
  registry.on_presence({Mesh::thread, "configured", Presence::offline, ""}, {TimePoint{1h}, {}});
  hear(registry, "honest", 0, 3600);
  for (int i = 0; i < 1000; ++i) {
    const std::string stranger = "s" + std::to_string(i);
    registry.on_presence({Mesh::thread, stranger, Presence::online, ""}, {TimePoint{2h}, {}});
    ASSERT_TRUE(registry.find(stranger)) << "a newcomer has a place";
    ASSERT_LE(registry.robots().size(), 100u);
  }
  EXPECT_TRUE(registry.find("configured"));
  EXPECT_TRUE(registry.find("honest"));
  EXPECT_GE(registry.take_evicted().size(), 902u);
  EXPECT_EQ(registry.count(Presence::online) + registry.count(Presence::offline),
            registry.robots().size());
}

TEST(RobotRegistry, TracksNoStrangersWhenConfiguredRobotsFillIt) {
  RobotRegistry registry(3);
  registry.set_configured({"a", "b", "c"});
  for (const char* robot : {"a", "b", "c"}) hear(registry, robot, 0, 0);
  EXPECT_FALSE(registry.on_report(report_of("one more", Mesh::thread), {}));
  EXPECT_EQ(registry.untracked(), 1u);
  EXPECT_TRUE(registry.on_report(report_of("a", Mesh::thread), {}));
}

TEST(RobotRegistry, ForgetsARobot) {
  RobotRegistry registry;
  registry.on_presence({Mesh::ble, "a", Presence::online, ""}, {});
  EXPECT_TRUE(registry.forget("a"));
  EXPECT_FALSE(registry.forget("a"));
  EXPECT_EQ(registry.count(Presence::online), 0u);
  EXPECT_TRUE(registry.robots().empty());
}

}  // namespace
}  // namespace slamgw
