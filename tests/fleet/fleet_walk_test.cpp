// SPDX-License-Identifier: Apache-2.0
// The ownership protocol in random worlds: no user may notice anything.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/fleet/fleet_world.hpp"

namespace slamgw::fleet::test {
namespace {

using namespace std::chrono_literals;

void expect_good(const FleetWorld& world, const char* what, int may_miss = 0) {
  const auto all = world.judge();
  const bool is_good = all.doubled_commands + all.doubled_outcomes +
                           std::max(0, all.missing_outcomes - may_miss) + all.false_wills +
                           all.missing_wills + all.two_owners + all.without_owner +
                           all.strange_presence ==
                       0;
  EXPECT_TRUE(is_good) << what << ": doubled " << all.doubled_commands << ", outcomes doubled "
                       << all.doubled_outcomes << " missing " << all.missing_outcomes
                       << ", wills false " << all.false_wills << " missing " << all.missing_wills
                       << ", two owners " << all.two_owners << ", none " << all.without_owner
                       << ", presence " << all.strange_presence;
  if (!is_good && std::getenv("SLAMGW_STORY")) std::cerr << world.describe();
}

int pick(std::mt19937& random, int count) {
  return std::uniform_int_distribution<int>(0, count - 1)(random);
}

/// The robots of that gateway look for another one.
void leave(FleetWorld& world, int victim, std::mt19937& random) {
  for (int robot = 0; robot < world.robots(); ++robot) {
    if (world.place_of(robot) == victim)
      world.roam(robot, (victim + 1 + pick(random, world.gateways() - 1)) % world.gateways());
  }
}

class FleetWalk : public testing::TestWithParam<std::uint32_t> {};

TEST_P(FleetWalk, RobotsRoamAndObey) {
  FleetWorld world({.seed = GetParam()});
  std::mt19937 random(GetParam());
  world.run(5s);
  for (int step = 0; step < 200; ++step) {
    if (step % 5 == 0) world.roam(pick(random, world.robots()), pick(random, world.gateways()));
    world.command(pick(random, world.robots()));
    world.run(100ms);
  }
  world.run(60s);
  expect_good(world, "roaming");
}

TEST_P(FleetWalk, GatewaysDieAndComeBack) {
  FleetWorld world({.seed = GetParam()});
  std::mt19937 random(GetParam() + 1000);
  world.run(5s);
  for (int round = 0; round < 6; ++round) {
    // One lives on: what all who heard a command have forgotten, nobody can tell.
    const int victim = pick(random, world.gateways() - 1);
    world.kill(victim);
    for (int step = 0; step < 20; ++step) {
      world.command(pick(random, world.robots()));
      world.run(50ms);
    }
    leave(world, victim, random);
    world.run(milliseconds(pick(random, 8000)));
    world.start(victim);
    world.run(milliseconds(pick(random, 3000)));
  }
  world.run(60s);
  expect_good(world, "killed");
}

TEST_P(FleetWalk, GatewaysStandStillAndGoOn) {
  FleetWorld world({.seed = GetParam()});
  std::mt19937 random(GetParam() + 2000);
  world.run(5s);
  for (int round = 0; round < 5; ++round) {
    const int victim = pick(random, world.gateways());
    world.pause(victim);
    world.run(milliseconds(pick(random, 3000)));
    leave(world, victim, random);
    for (int step = 0; step < 20; ++step) {
      world.command(pick(random, world.robots()));
      world.run(100ms);
    }
    world.run(milliseconds(pick(random, 60000)));
    world.resume(victim);
    world.run(milliseconds(pick(random, 4000)));
  }
  world.run(60s);
  expect_good(world, "stopped");
}

TEST_P(FleetWalk, LinksBreakAndRobotsDie) {
  FleetWorld world({.seed = GetParam(), .most_delay = 120ms});
  std::mt19937 random(GetParam() + 3000);
  world.run(5s);
  for (int round = 0; round < 8; ++round) {
    const int victim = pick(random, world.gateways());
    world.cut_link(victim);
    world.run(milliseconds(pick(random, 5000)));
    world.roam(pick(random, world.robots()), pick(random, world.gateways()));
    world.restore_link(victim);
    world.run(milliseconds(pick(random, 3000)));
  }
  world.run(5s);
  world.silence(0);
  world.silence(1);
  world.run(10s);
  expect_good(world, "cut");
}

/// What the broker would have sent meanwhile is lost. A cut is too short for anybody to be called
/// dead.
TEST_P(FleetWalk, ShortCutsWithoutASessionAtTheBroker) {
  FleetWorld world({.seed = GetParam()});
  std::mt19937 random(GetParam() + 5000);
  world.run(5s);
  for (int round = 0; round < 60; ++round) {
    const int victim = pick(random, world.gateways());
    world.cut_link(victim);
    for (int step = 0; step < 4; ++step) {
      if (pick(random, 4) == 0)
        world.roam(pick(random, world.robots()), pick(random, world.gateways()));
      world.command(pick(random, world.robots()));
      world.run(milliseconds(pick(random, 100)));
    }
    world.restore_link(victim);
    world.run(milliseconds(pick(random, 1000)));
  }
  world.run(60s);
  // A gateway that begins anew leaves what came before to the others, of whom one may have missed
  // it.
  constexpr int bound = 2;  // of 240 commands
  expect_good(world, "cut without session", bound);
}

/// Both sides may act while they are apart: without a quorum nobody can know. They must end in one.
TEST_P(FleetWalk, SidesThatWereApartEndInOneOwner) {
  FleetWorld world({.seed = GetParam()});
  std::mt19937 random(GetParam() + 4000);
  world.run(5s);
  world.is_trusted = false;
  world.set_side(0, 1);
  world.set_side(1, 1);
  for (int step = 0; step < 10; ++step) {
    world.roam(pick(random, world.robots()), pick(random, world.gateways()));
    world.run(milliseconds(pick(random, 3000)));
  }
  world.set_side(0, 0);
  world.set_side(1, 0);
  world.run(8s);
  world.is_trusted = true;
  world.run(10s);
  expect_good(world, "apart");
}

INSTANTIATE_TEST_SUITE_P(Seeds, FleetWalk, testing::Range(1U, 7U));

}  // namespace
}  // namespace slamgw::fleet::test
