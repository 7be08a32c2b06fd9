// SPDX-License-Identifier: Apache-2.0
// What is promised to users of a mesh in which several gateways have boards, one sentence each.
#include <gtest/gtest.h>

#include "tests/fleet/shared_mesh.hpp"

namespace slamgw::fleet::test {
namespace {

using namespace std::chrono_literals;

constexpr Now start{TimePoint{} + 1h, {}};

void expect_good(const SharedMesh& mesh, milliseconds longest) {
  const auto all = mesh.judge();
  EXPECT_GT(all.messages, 0);
  EXPECT_EQ(all.lost, 0);
  EXPECT_EQ(all.beyond, 0) << all.doubled << " doubled";
  EXPECT_EQ(all.two_owners, 0);
  EXPECT_LE(all.longest.count(), longest.count());
}

int owner_of(const SharedMesh& mesh, int robot) {
  const auto found = mesh.servers(robot);
  return found.size() == 1 ? found.front() : -1;
}

TEST(SharedMesh, EveryMessageGoesUpOnceThoughAllBoardsHearIt) {
  SharedMesh mesh({.gateways = 3});
  mesh.run(10s);
  const int doubled = mesh.judge().doubled;
  std::vector<int> owners;
  for (int robot = 0; robot < 4; ++robot) owners.push_back(mesh.takeovers(robot));
  mesh.run(60s);
  expect_good(mesh, 5s);
  EXPECT_EQ(mesh.judge().doubled, doubled) << "none since they have agreed";
  for (std::size_t robot = 0; robot < 4; ++robot)
    EXPECT_EQ(mesh.takeovers(static_cast<int>(robot)), owners[robot]);
}

TEST(SharedMesh, AnotherServesTheRobotsOfAGatewayThatDies) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    SharedMesh mesh({.seed = seed});
    mesh.run(20s + milliseconds(seed * 61));
    const int victim = owner_of(mesh, 0);
    ASSERT_GE(victim, 0);
    mesh.kill(victim);
    mesh.run(10s);
    EXPECT_EQ(owner_of(mesh, 0), 1 - victim);
    mesh.start(victim);
    mesh.run(10s);
    EXPECT_EQ(owner_of(mesh, 0), 1 - victim) << "it comes back, and hears nobody better";
    expect_good(mesh, 5s);
  }
}

TEST(SharedMesh, AnotherServesTheRobotsOfABoardThatDies) {
  SharedMesh mesh({});
  mesh.run(20s);
  const int victim = owner_of(mesh, 0);
  ASSERT_GE(victim, 0);
  mesh.set_board(victim, false);
  mesh.run(1s);
  for (int robot = 0; robot < 4; ++robot) EXPECT_EQ(owner_of(mesh, robot), 1 - victim);
  mesh.set_board(victim, true);
  mesh.run(20s);
  expect_good(mesh, 5s);
}

TEST(SharedMesh, AnotherServesTheRobotsThatABoardHearsNoMore) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    SharedMesh mesh({.seed = seed});
    mesh.run(20s + milliseconds(seed * 61));
    const int victim = owner_of(mesh, 0);
    ASSERT_GE(victim, 0);
    mesh.set_deaf(victim, true);
    mesh.run(10s);
    for (int robot = 0; robot < 4; ++robot) EXPECT_EQ(owner_of(mesh, robot), 1 - victim);
    expect_good(mesh, 5s);
  }
}

TEST(SharedMesh, ARobotGoesToTheBoardThatHearsItClearlyBetterForAWhile) {
  SharedMesh mesh({.robots = 1});
  mesh.run(20s);
  const int first = owner_of(mesh, 0);
  ASSERT_GE(first, 0);
  mesh.set_level(1 - first, 0, -60 + BoardChoice::clearly_better_db + 2);
  mesh.run(4s);
  EXPECT_EQ(owner_of(mesh, 0), first) << "not for a moment's sake";
  mesh.run(8s);
  EXPECT_EQ(owner_of(mesh, 0), 1 - first);
  mesh.set_level(first, 0, -60 + BoardChoice::clearly_better_db);
  mesh.run(60s);
  EXPECT_EQ(owner_of(mesh, 0), 1 - first) << "nor back, when they are about equal";
  EXPECT_EQ(mesh.takeovers(0), 2);
  expect_good(mesh, 5s);
}

/// People walk about: levels change by 8 dB every two seconds.
TEST(SharedMesh, OwnershipDoesNotFollowEveryFade) {
  SharedMesh mesh({});
  std::mt19937 random(7);
  mesh.run(10s);
  for (int step = 0; step < 150; ++step) {
    for (int robot = 0; robot < 4; ++robot)
      for (int gateway = 0; gateway < 2; ++gateway)
        mesh.set_level(gateway, robot, -60 - static_cast<int>(random() % 9));
    mesh.run(2s);
  }
  for (int robot = 0; robot < 4; ++robot) EXPECT_EQ(mesh.takeovers(robot), 1);
  expect_good(mesh, 5s);
}

TEST(SharedMesh, NobodyServesWhileTheBrokerIsAwayAndOneDoesAfterwards) {
  SharedMesh mesh({});
  mesh.run(10s);
  mesh.cut_link(0);
  mesh.cut_link(1);
  mesh.run(20s);
  for (int robot = 0; robot < 4; ++robot) EXPECT_TRUE(mesh.servers(robot).empty());
  mesh.restore_link(0);
  mesh.restore_link(1);
  mesh.run(40s);
  for (int robot = 0; robot < 4; ++robot) EXPECT_GE(owner_of(mesh, robot), 0);
  expect_good(mesh, 60s);
}

class SharedMeshWalk : public testing::TestWithParam<std::uint32_t> {};

/// Gateways die, boards die, links break, the radio loses a tenth: nothing that was
/// acknowledged is lost, and each end of a gateway's service doubles one message of a robot at
/// most.
TEST_P(SharedMeshWalk, NothingIsLostAndDoublesAreBounded) {
  SharedMesh mesh({.seed = GetParam(), .gateways = 3, .radio_loss = 0.1, .broker_loss = 0.02});
  std::mt19937 random(GetParam());
  mesh.run(10s);
  for (int round = 0; round < 12; ++round) {
    const int victim = static_cast<int>(random() % 3);
    const auto span = milliseconds(random() % 8000);
    switch (random() % 4) {
      case 0:
        mesh.kill(victim);
        mesh.run(span);
        mesh.start(victim);
        break;
      case 1:
        mesh.set_board(victim, false);
        mesh.run(span);
        mesh.set_board(victim, true);
        break;
      case 2:
        mesh.set_deaf(victim, true);
        mesh.run(span);
        mesh.set_deaf(victim, false);
        break;
      case 3:
        mesh.cut_link(victim);
        mesh.run(span);
        mesh.restore_link(victim);
        break;
    }
    mesh.run(milliseconds(random() % 6000));
  }
  mesh.run(70s);
  expect_good(mesh, 60s);
  for (int robot = 0; robot < 4; ++robot) EXPECT_GE(owner_of(mesh, robot), 0);
}

INSTANTIATE_TEST_SUITE_P(Seeds, SharedMeshWalk, testing::Range(1U, 21U));

// --- Who may serve -------------------------------------------------------------------------------

Ownership alone(Enabled enabled) {
  return {{"p", "gw-0"}, {enabled, 0x10000}, [] { return std::vector<LocalRobot>{}; }};
}

TEST(SharedMesh, NobodyServesBeforeTheBrokerHasToldWhoIsAbout) {
  Ownership ownership = alone(Enabled::automatic);
  const auto may_serve = [&](Duration after) {
    return ownership.may_serve("r", start.mono + after);
  };
  EXPECT_FALSE(may_serve(0s));
  ownership.on_broker_link(true, start);
  EXPECT_FALSE(may_serve(1ms));
  ownership.on_deadline({start.mono + 10s, {}});
  EXPECT_TRUE(may_serve(10s)) << "alone";
  ownership.on_broker_link(false, {start.mono + 20s, {}});
  EXPECT_TRUE(may_serve(20s)) << "it was alone, and the store keeps what it acknowledges";
}

TEST(SharedMesh, WhoTakesNoPartServesAll) {
  EXPECT_TRUE(alone(Enabled::no).may_serve("r", start.mono));
}

}  // namespace
}  // namespace slamgw::fleet::test
