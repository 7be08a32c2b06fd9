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

TEST(RobotBody, ProducesSamePayloadsForSameSeedAndNumber) {
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

Place point(const Bytes& update, std::size_t offset) {
  return {static_cast<double>(get_i16_le(update, offset)),
          static_cast<double>(get_i16_le(update, offset + 2))};
}

TEST(RobotBody, LimitsObstaclesAndOmitsStrayOctet) {
  BodySettings settings;
  settings.max_obstacles = 1;
  settings.has_stray = false;
  RobotBody body(1, 1, settings);
  std::set<std::size_t> sizes;
  for (int i = 0; i < 200; ++i) sizes.insert(body.next_update().size());
  EXPECT_EQ(sizes, (std::set<std::size_t>{4, 8}));
}

/// The update of the robots before the thesis: 12 octets after its type.
TEST(RobotBody, ProducesFullPayload) {
  BodySettings settings;
  settings.payload = BodySettings::Payload::full;
  RobotBody body(1, 1, settings);
  const Bytes update = body.next_update();
  ASSERT_EQ(update.size(), 13U);
  EXPECT_EQ(update[0], 0x01);
  const Place place = point(update, 1);
  EXPECT_LE(std::hypot(place.x_cm, place.y_cm), 70);
  EXPECT_LE(std::abs(get_i16_le(update, 5)), 180);
}

/// Returns the mean distance of obstacles from the walls of the room.
double room_error_cm(const BodySettings& settings) {
  RobotBody body(3, 1, settings);
  double sum = 0;
  int count = 0;
  for (int i = 0; i < 1000; ++i) {
    const Bytes update = body.next_update();
    for (std::size_t at = 4; at + 4 <= update.size(); at += 4) {
      const Place p = point(update, at);
      const double to_wall =
          std::min({std::abs(p.x_cm + 150), std::abs(p.x_cm - 110), std::abs(p.x_cm - 30),
                    std::abs(p.y_cm + 90), std::abs(p.y_cm - 90), std::abs(p.y_cm - 10)});
      sum += to_wall;
      ++count;
    }
  }
  return sum / count;
}

TEST(RobotBody, MapsTheRoomOnlyWhenPoseAndObstaclesAgree) {
  BodySettings settings;
  settings.world = World::Shape::room;
  EXPECT_LT(room_error_cm(settings), 1.5);
  settings.model = BodySettings::Model::thesis;
  EXPECT_LT(room_error_cm(settings), 4);
  settings.is_mirrored = true;
  EXPECT_GT(room_error_cm(settings), 15);
}

TEST(RobotBody, ThesisTowerStandsWhileTheRobotTurns) {
  BodySettings settings;
  settings.model = BodySettings::Model::thesis;
  settings.payload = BodySettings::Payload::full;
  RobotBody body(1, 1, settings);
  Bytes last = body.next_update();
  int turned = 0;
  int drove = 0;
  for (int i = 0; i < 500; ++i) {
    const Bytes next = body.next_update();
    const bool has_turned = get_i16_le(next, 5) != get_i16_le(last, 5);
    const bool has_tower_moved = get_i16_le(next, 7) != get_i16_le(last, 7);
    EXPECT_FALSE(has_turned && has_tower_moved);
    turned += has_turned ? 1 : 0;
    drove += has_tower_moved ? 1 : 0;
    for (std::size_t sensor = 9; sensor < 13; ++sensor) EXPECT_GT(next[sensor], 5);
    last = next;
  }
  EXPECT_GT(turned, 20);
  EXPECT_GT(drove, 200);
}

TEST(RobotBody, DrivesToItsTarget) {
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
