// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/round_trip.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using std::chrono::milliseconds;

TEST(RoundTrip, FollowsRfc6298) {
  RoundTrip trip(milliseconds(1));
  EXPECT_FALSE(trip.is_known());
  trip.on_answer(milliseconds(100));  // (2.2): SRTT 100, RTTVAR 50
  EXPECT_TRUE(trip.is_known());
  EXPECT_EQ(trip.timeout(), milliseconds(300));
  trip.on_answer(milliseconds(180));  // (2.3): RTTVAR 57.5, SRTT 110
  EXPECT_EQ(trip.timeout(), milliseconds(340));
}

TEST(RoundTrip, IgnoresDifferencesBelowItsGranularity) {
  RoundTrip trip(milliseconds(100));
  for (int i = 0; i < 200; ++i) trip.on_answer(milliseconds(20));
  EXPECT_EQ(trip.timeout(), milliseconds(120));
}

}  // namespace
}  // namespace slamgw
