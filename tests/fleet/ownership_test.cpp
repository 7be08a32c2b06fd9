// SPDX-License-Identifier: Apache-2.0
// What is promised to users of a fleet, one sentence each.
#include <gtest/gtest.h>

#include <array>

#include "tests/fleet/fleet_world.hpp"

namespace slamgw::fleet::test {
namespace {

using namespace std::chrono_literals;

TEST(Ownership, OneGatewayAloneSaysNothing) {
  FleetWorld world({.gateways = 1, .robots = 3, .enabled = Enabled::automatic});
  world.run(30s);
  EXPECT_TRUE(world.ownership(0).is_alone());
  EXPECT_EQ(world.published_by_kind("beat"), 0U);
  EXPECT_EQ(world.published_by_kind("claim"), 0U);
}

TEST(Ownership, WakesUpWhenAnotherGatewayIsThereAndSleepsWhenItHasGone) {
  FleetWorld world({.gateways = 2, .robots = 3, .enabled = Enabled::automatic});
  world.kill(1);
  world.run(90s);
  EXPECT_TRUE(world.ownership(0).is_alone());
  world.start(1);
  world.run(5s);
  EXPECT_EQ(world.ownership(0).phase(), Ownership::Phase::member);
  EXPECT_EQ(world.ownership(1).phase(), Ownership::Phase::member);
  world.kill(1);
  world.run(90s);
  EXPECT_TRUE(world.ownership(0).is_alone());
}

TEST(Ownership, RobotThatRoamsHasOneOwnerWithinAFractionOfASecond) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  ASSERT_EQ(world.actors(0), std::vector<int>{0});
  world.roam(0, 2);
  world.run(300ms);
  EXPECT_EQ(world.actors(0), std::vector<int>{2});
}

/// A -> B -> C, and C claims it while A has not made way for B yet.
TEST(Ownership, SessionFollowsARobotThatMovesTwiceWithinOneHandover) {
  int lost = 0;
  for (std::uint32_t seed = 1; seed <= 40; ++seed) {
    FleetWorld world({.seed = seed, .gateways = 4, .robots = 1});
    world.run(5s);
    for (const int place : {1, 3}) {
      world.roam(0, place);
      world.run(milliseconds(seed * 3));
    }
    world.run(10s);
    const bool is_well = world.has_session(0) && world.actors(0) == std::vector<int>{3};
    if (!is_well && std::getenv("SLAMGW_STORY")) std::cerr << seed << '\n' << world.describe();
    lost += is_well ? 0 : 1;
  }
  EXPECT_EQ(lost, 0) << "of 40 robots";
}

TEST(Ownership, RobotOfADeadGatewayHasANewOwnerWithinTwoSeconds) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  world.kill(0);
  world.roam(0, 1);
  world.run(2s);
  EXPECT_EQ(world.actors(0), std::vector<int>{1});
}

TEST(Ownership, ARoamCostsTwoMessagesAndACommandOne) {
  FleetWorld world({.gateways = 3, .robots = 1, .doubled = 0});
  world.run(5s);
  const auto before = world.published();
  const auto beats = world.published_by_kind("beat");
  world.roam(0, 1);
  world.run(2s);
  EXPECT_EQ(world.published() - before - (world.published_by_kind("beat") - beats), 2U);
  world.command(0);
  world.run(5s);
  EXPECT_EQ(world.published_by_kind("taken"), 1U);
  EXPECT_LE(world.published_by_kind("beat") - beats, 3U * 2U * 7U + 3U);
}

TEST(Ownership, PausedGatewayActsForNobodyWhenItGoesOn) {
  FleetWorld world({.gateways = 2, .robots = 2});
  world.run(5s);
  world.pause(0);
  world.roam(0, 1);
  world.run(60s);
  world.command(0);
  world.run(1s);
  world.resume(0);
  world.run(5s);
  EXPECT_EQ(world.actors(0), std::vector<int>{1});
  const auto all = world.judge();
  EXPECT_EQ(all.two_owners + all.doubled_commands + all.doubled_outcomes + all.false_wills, 0);
}

TEST(Ownership, TwoRobotsWithOneNameAreToldAndDoNotFlood) {
  FleetWorld world({.gateways = 2, .robots = 1});
  world.run(5s);
  const auto before = world.published_by_kind("claim");
  for (int step = 0; step < 600; ++step) {  // for two minutes, five times a second
    world.roam(0, step % 2);
    world.run(200ms);
  }
  EXPECT_LE(world.published_by_kind("claim") - before, 24U);
  EXPECT_NE(world.describe().find("two robots with this name"), std::string::npos);
}

TEST(Ownership, ForgedClaimsOfUnknownGatewaysAreVoid) {
  FleetWorld world({.gateways = 2, .robots = 1});
  world.run(5s);
  world.forge(
      "p/fleet/all/evil",
      R"({"v":1,"b":"0000000000010000","k":"claim","robot":"r o.b*0","epoch":99,"from":""})");
  world.forge(
      "p/fleet/all/gw-0",  // the right gateway, in a life that is not its own
      R"({"v":1,"b":"0000000000010000","k":"claim","robot":"r o.b*0","epoch":99,"from":""})");
  world.forge("p/fleet/all/gw-0", "no JSON");
  world.forge("p/fleet/all/gw-1", std::string(1'000'000, '['));
  world.forge("p/fleet/to/gw-1/gw-0", R"({"v":1,"b":"0","k":"table"})");
  world.run(3s);
  EXPECT_EQ(world.actors(0), std::vector<int>{0});
}

/// As a client that may write under fleet/ in any name.
void forge_claim(FleetWorld& world, const std::string& gateway, Life life, int robot,
                 std::uint64_t epoch) {
  world.forge("p/fleet/all/" + gateway,
              encode(life, ClaimRobot{FleetWorld::robot_name(robot), epoch, {}}));
}
void forge_beat(FleetWorld& world, const std::string& gateway, Life life) {
  world.forge("p/fleet/all/" + gateway, encode(life, Beat{world.now() / 1ms, 500, 1, 1, 0}));
}

class ForgedEpoch : public testing::TestWithParam<std::uint64_t> {};

TEST_P(ForgedEpoch, CostsARobotSecondsWhenItsForgerIsSilent) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  for (int i = 0; i < 4; ++i) {
    forge_beat(world, "evil", 0x70000);
    forge_claim(world, "evil", 0x70000, 0, GetParam());
    world.run(500ms);
  }
  world.run(4s);
  EXPECT_EQ(world.actors(0), std::vector<int>{0});
  for (const int place : {1, 0, 2}) {  // as before
    world.roam(0, place);
    world.run(1s);
    EXPECT_EQ(world.actors(0), std::vector<int>{place});
  }
}

/// Neither the gateway that is named nor the others keep such a claim.
TEST_P(ForgedEpoch, CostsARobotSecondsWhenItIsInTheNameOfALivingGateway) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  forge_claim(world, "gw-1", world.ownership(1).life(), 0, GetParam());
  world.run(8s);
  EXPECT_EQ(world.actors(0), std::vector<int>{0});
  for (const int place : {1, 0, 2}) {
    world.roam(0, place);
    world.run(2s);
    EXPECT_EQ(world.actors(0), std::vector<int>{place});
  }
}

INSTANTIATE_TEST_SUITE_P(Highest, ForgedEpoch,
                         testing::Values(max_epoch, max_epoch - 1, max_epoch - 2, spent_epoch,
                                         spent_epoch - 1, 1000));

TEST(Ownership, ServesItsRobotsWhenTheBrokerForbidsTheFleet) {
  FleetWorld world({.gateways = 2, .robots = 2, .enabled = Enabled::automatic});
  world.forbid_fleet();
  world.run(30s);
  EXPECT_TRUE(world.ownership(0).is_alone());
  EXPECT_TRUE(world.ownership(1).is_alone());
  EXPECT_EQ(world.actors(0), (std::vector<int>{0, 1}));  // as before there were fleets
}

TEST(Ownership, TheProbeOfAnotherGatewayIsNoCommand) {
  FleetWorld world({.gateways = 2, .robots = 1});
  world.run(5s);
  world.forge("p/server/gw-0/probe", "1-1");
  world.run(10s);
  EXPECT_EQ(world.published_by_kind("taken"), 0U);
}

TEST(Ownership, RobotMayBeNamedAsAGateway) {
  const FleetTopics topics("p", "gw-0");
  EXPECT_EQ(topics.all(), "p/fleet/all/gw-0");  // robots' names are in no topic of the fleet
  EXPECT_EQ(topics.sender("p/fleet/to/gw-0/gw-1"), "gw-1");
  EXPECT_FALSE(topics.sender("p/fleet/to/gw-1/gw-0"));
}

}  // namespace
}  // namespace slamgw::fleet::test
