// SPDX-License-Identifier: Apache-2.0
// The robots' world: the same seed means the same payloads.
#include "simulation/robot_body.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim {
namespace {

std::vector<Bytes> payloads(std::uint64_t seed, unsigned number, int count) {
  RobotBody body(seed, number);
  std::vector<Bytes> out{body.introduction()};
  for (int i = 0; i < count; ++i) out.push_back(body.next_update());
  return out;
}

TEST(RobotBody, SaysTheSameForTheSameSeedAndNumber) {
  EXPECT_EQ(payloads(7, 2, 500), payloads(7, 2, 500));
}

TEST(RobotBody, DiffersBetweenRobotsAndSeeds) {
  EXPECT_NE(payloads(7, 1, 50), payloads(7, 2, 50));
  EXPECT_NE(payloads(7, 1, 50), payloads(8, 1, 50));
}

TEST(RobotBody, KeepsItsPayloadsOverVersions) {
  EXPECT_EQ(to_hex(payloads(1, 1, 0)[0]), "01 00 0d 12 09 06");
  EXPECT_EQ(to_hex(payloads(1, 1, 1)[1]), "e6 ff 00 00 af ff f7 ff f3 ff b1 ff db ff 47 00 d0");
}

TEST(RobotBody, StaysInTheRingAndSeesTheRing) {
  std::set<std::size_t> obstacle_counts;
  for (unsigned number = 1; number <= 5; ++number) {
    std::vector<Bytes> all = payloads(3, number, 2000);
    all.erase(all.begin());
    for (const Bytes& payload : all) {
      ASSERT_GE(payload.size(), 5U);
      ASSERT_EQ(payload.size() % 4, 1U);
      const std::size_t obstacles = (payload.size() - 5) / 4;
      ASSERT_LE(obstacles, 4U);
      obstacle_counts.insert(obstacles);
      const double x = get_i16_le(payload, 0);
      const double y = get_i16_le(payload, 2);
      ASSERT_LE(std::hypot(x, y), 70);
      for (std::size_t i = 4; i + 4 <= payload.size(); i += 4) {
        const double ox = get_i16_le(payload, i);
        const double oy = get_i16_le(payload, i + 2);
        ASSERT_NEAR(std::hypot(ox, oy), 80, 3.5);
        ASSERT_LE(std::hypot(ox - x, oy - y), 82);
        ASSERT_GT(std::hypot(ox - x, oy - y), 12);
      }
    }
  }
  EXPECT_EQ(obstacle_counts, (std::set<std::size_t>{0, 1, 2, 3, 4}));
}

TEST(RobotBody, GoesWhereItIsSent) {
  RobotBody body(1, 1);
  double nearest = 1000;
  body.head_for(40, -30);
  for (int i = 0; i < 100; ++i) {
    const Bytes update = body.next_update();
    nearest =
        std::min(nearest, std::hypot(get_i16_le(update, 0) - 40.0, get_i16_le(update, 2) + 30.0));
  }
  EXPECT_LE(nearest, 5);
}

TEST(RobotBody, StandsStillWhileStopped) {
  RobotBody body(1, 1);
  body.set_running(false);
  const Bytes first = body.next_update();
  const Bytes second = body.next_update();
  EXPECT_EQ(Bytes(first.begin(), first.begin() + 4), Bytes(second.begin(), second.begin() + 4));
}

}  // namespace
}  // namespace slamgw::sim
