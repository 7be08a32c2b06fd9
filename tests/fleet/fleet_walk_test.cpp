// SPDX-License-Identifier: Apache-2.0
// The ownership protocol in random worlds: no user may notice anything.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>

#include "tests/fleet/fleet_world.hpp"

namespace slamgw::fleet::test {
namespace {

using namespace std::chrono_literals;

/// A gateway of which two beats in a row are lost begins anew, which takes seconds; so none is lost
/// just before the last look.
void expect_good(FleetWorld& world, const char* what) {
  world.lose_nothing();
  world.run(5s);
  const auto all = world.judge();
  const bool is_good = all.doubled_commands + all.doubled_outcomes + all.missing_outcomes +
                           all.false_wills + all.missing_wills + all.two_owners +
                           all.without_owner + all.strange_presence ==
                       0;
  EXPECT_TRUE(is_good) << what << ": doubled " << all.doubled_commands << ", outcomes doubled "
                       << all.doubled_outcomes << " missing " << all.missing_outcomes
                       << ", wills false " << all.false_wills << " missing " << all.missing_wills
                       << ", two owners " << all.two_owners << ", two online " << all.two_online
                       << ", none " << all.without_owner << ", presence " << all.strange_presence;
  if (!is_good && std::getenv("SLAMGW_STORY")) std::cerr << world.describe();
}

/// What is promised of commands, and of presence. Those that came while no gateway was there are
/// nobody's.
void expect_one_outcome_each(const FleetWorld& world, const std::string& what) {
  const auto all = world.judge();
  const bool is_good =
      all.doubled_commands + all.doubled_outcomes + all.missing_outcomes + all.two_online == 0;
  EXPECT_TRUE(is_good) << what << ": commands doubled " << all.doubled_commands
                       << ", outcomes doubled " << all.doubled_outcomes << " missing "
                       << all.missing_outcomes << " repeated " << all.repeated_outcomes
                       << ", commands unheard " << all.unheard_commands << ", two online "
                       << all.two_online;
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

/// As NATS: the broker takes the subscriptions of a connection one after the other.
constexpr milliseconds slow_subscribing{500};

/// What the broker would have sent meanwhile is lost. A cut is too short for anybody to be called
/// dead, if no other beat is lost, unless the broker is slow.
TEST_P(FleetWalk, ShortCutsWithoutASessionAtTheBroker) {
  const bool is_slow = GetParam() % 3 == 0;
  FleetWorld world(
      {.seed = GetParam(), .lost = 0, .subscribing = is_slow ? slow_subscribing : milliseconds(0)});
  std::mt19937 random(GetParam() + 5000);
  world.run(is_slow ? 10s : 5s);
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
    world.run(milliseconds(pick(random, is_slow ? 20000 : 1000)));
  }
  world.run(60s);
  expect_good(world, "cut without session");
}

/// Cuts of gateways from the broker, again and again, each with a command every 0.2 s.
struct Cuts {
  const char* name;
  int gateways;  ///< of four that are cut at once
  milliseconds least;
  milliseconds most;
  bool keeps_sessions;
  milliseconds subscribing{0};
};

class FleetCuts : public testing::TestWithParam<std::tuple<Cuts, std::uint32_t>> {
 protected:
  static constexpr int rounds = 4;

  void command_for(milliseconds span) {
    for (const milliseconds end = world.now() + span; world.now() < end;) {
      world.command(pick(random, world.robots()));
      if (pick(random, 10) == 0)
        world.roam(pick(random, world.robots()), pick(random, world.gateways()));
      world.run(milliseconds(pick(random, 400)));
    }
  }

  const Cuts& cuts = std::get<0>(GetParam());
  const std::uint32_t seed = std::get<1>(GetParam());
  std::mt19937 random{seed + 7000};
  FleetWorld world{{.seed = seed,
                    .lost = 0,
                    .has_unique_types = true,
                    .keeps_sessions = cuts.keeps_sessions,
                    .subscribing = cuts.subscribing}};
};

TEST_P(FleetCuts, EachCommandHasOneOutcome) {
  world.run(5s + 5 * cuts.subscribing);  // until all take part
  for (int round = 0; round < rounds; ++round) {
    const int first = pick(random, world.gateways());
    for (int i = 0; i < cuts.gateways; ++i) {
      const int victim = (first + i) % world.gateways();
      world.cut_link(victim);
      if (pick(random, 2) == 0) leave(world, victim, random);
      command_for(milliseconds(pick(random, 500)));
    }
    const auto spread = static_cast<int>((cuts.most - cuts.least).count());
    command_for(cuts.least + milliseconds(pick(random, spread)));
    for (int i = 0; i < cuts.gateways; ++i) {
      world.restore_link((first + i) % world.gateways());
      world.run(milliseconds(pick(random, 2000)));
    }
    command_for(milliseconds(pick(random, 5000)));
  }
  world.run(90s);
  expect_one_outcome_each(world, cuts.name);
}

/// For 20 s somebody claims robots in all names, with epochs up to the highest. Meanwhile anything
/// may happen; then each robot has an owner again, and goes on to others.
TEST_P(FleetWalk, ForgedClaimsCostSecondsOnly) {
  FleetWorld world({.seed = GetParam(), .lost = 0});  // two lost beats cost seconds, too
  std::mt19937 random(GetParam() + 6000);
  world.run(5s);
  world.is_trusted = false;
  for (int step = 0; step < 100; ++step) {
    const int liar = pick(random, world.gateways() + 1);
    const bool is_stranger = liar == world.gateways();
    const std::string name = is_stranger ? "evil" : "gw-" + std::to_string(liar);
    const Life life = is_stranger ? 0x70000 : world.ownership(liar).life();
    const std::uint64_t epoch = pick(random, 2) == 0
                                    ? max_epoch - static_cast<std::uint64_t>(pick(random, 4))
                                    : spent_epoch - 2 + static_cast<std::uint64_t>(pick(random, 4));
    const auto say = [&](const Body& body) {
      world.forge("p/fleet/all/" + name, encode(life, body));
    };
    if (is_stranger) say(Beat{world.now() / 1ms, 500, 1, 1, 0});
    say(ClaimRobot{FleetWorld::robot_name(pick(random, world.robots())), epoch, {}});
    world.roam(pick(random, world.robots()), pick(random, world.gateways()));
    world.run(milliseconds(pick(random, 400)));
  }
  world.run(40s);  // a robot that moved so often is claimed ever more slowly
  for (int round = 0; round < 2; ++round) {
    for (int robot = 0; robot < world.robots(); ++robot) {
      EXPECT_EQ(world.actors(robot), std::vector<int>{world.place_of(robot)}) << robot;
      world.roam(robot, (world.place_of(robot) + 1) % world.gateways());
    }
    world.run(3s);
  }
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

/// As many worlds as SLAMGW_SEEDS says.
std::uint32_t last_seed_or(std::uint32_t usual) {
  const char* count = std::getenv("SLAMGW_SEEDS");
  return count ? static_cast<std::uint32_t>(std::max(1, std::atoi(count))) : usual;
}

INSTANTIATE_TEST_SUITE_P(
    Seeds, FleetCuts,
    testing::Combine(
        testing::Values(Cuts{"long", 1, 20s, 38s, false}, Cuts{"long, kept", 1, 20s, 38s, true},
                        Cuts{"short", 1, 500ms, 5s, false}, Cuts{"short, kept", 1, 500ms, 5s, true},
                        Cuts{"longest", 1, 30s, 120s, false}, Cuts{"two", 2, 1s, 40s, false},
                        Cuts{"two, kept", 2, 1s, 40s, true}, Cuts{"all", 4, 1s, 40s, false},
                        Cuts{"all, kept", 4, 1s, 40s, true},
                        Cuts{"slow", 1, 500ms, 38s, false, slow_subscribing},
                        Cuts{"slow, all, kept", 4, 1s, 40s, true, slow_subscribing}),
        testing::Range(1U, last_seed_or(1) + 1)));
INSTANTIATE_TEST_SUITE_P(Seeds, FleetWalk, testing::Range(1U, last_seed_or(6) + 1));

}  // namespace
}  // namespace slamgw::fleet::test
