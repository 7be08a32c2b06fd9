// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_registry.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

Report report_of(const std::string& robot, Mesh mesh) {
  Report report;
  report.robot = robot;
  report.mesh = mesh;
  return report;
}

TEST(RobotRegistry, SpeaksForTheMeshWhereARobotIsOnline) {
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

TEST(RobotRegistry, AWillIsNoSignOfLife) {
  RobotRegistry registry;
  const Now early{TimePoint{1s}, WallTime{100s}};
  const Now late{TimePoint{61s}, WallTime{160s}};
  registry.on_report(report_of("a", Mesh::thread), early);
  Report will = report_of("a", Mesh::thread);
  will.is_will = true;
  registry.on_report(will, late);
  registry.on_presence({Mesh::thread, "a", Presence::offline, ""}, late);
  EXPECT_EQ(registry.find("a")->last_seen, early.wall);
  registry.on_sign_of_life("a", late);
  registry.on_sign_of_life("unknown", late);
  EXPECT_EQ(registry.find("a")->last_seen, late.wall);
  EXPECT_FALSE(registry.find("unknown"));
  EXPECT_EQ(registry.find("a")->numbers.up(), 1u);
}

TEST(RobotRegistry, TracksABoundedNumberAndCountsTheRest) {
  RobotRegistry registry;
  for (std::size_t i = 0; i < RobotRegistry::max_robots; ++i) {
    ASSERT_TRUE(registry.on_report(report_of("r" + std::to_string(i), Mesh::thread), {}));
  }
  EXPECT_FALSE(registry.on_report(report_of("one more", Mesh::thread), {}));
  EXPECT_EQ(registry.untracked(), 1u);
  EXPECT_TRUE(registry.on_report(report_of("r0", Mesh::thread), {})) << "known ones still count";
}

}  // namespace
}  // namespace slamgw
