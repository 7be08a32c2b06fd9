// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/log_throttle.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TEST(LogThrottle, ReportsTheFirstEventAtOnceAndThenTheirNumber) {
  LogThrottle throttle(10s);
  const TimePoint start{};
  EXPECT_EQ(throttle.on_event(start), 1u);
  EXPECT_EQ(throttle.on_event(start + 1s), std::nullopt);
  EXPECT_EQ(throttle.on_event(start + 9s), std::nullopt);
  EXPECT_EQ(throttle.on_event(start + 10s), 3u);
  EXPECT_EQ(throttle.on_event(start + 11s), std::nullopt);
}

}  // namespace
}  // namespace slamgw
