// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/backoff.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TEST(Backoff, DoublesUpToItsLimitAndStartsAgain) {
  Backoff backoff(500ms, 30s);
  std::chrono::milliseconds expected = 500ms;
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(backoff.next_wait(0.0, {}), expected / 2);
    expected = std::min<std::chrono::milliseconds>(30s, expected * 2);
  }
  backoff.reset();
  EXPECT_LE(backoff.next_wait(0.999, {}), 500ms);
}

TEST(Backoff, KeepsWaitsShortInTheFirstMinutesOfAnOutage) {
  TimePoint now{std::chrono::hours(1)};
  Backoff backoff(500ms, 30s, Backoff::Eager{3s, 5min});
  const TimePoint began = now;
  for (int tries = 0; now < began + 5min; ++tries) {
    const auto wait = backoff.next_wait(0.999, now);
    EXPECT_LE(wait, 3s);
    now += wait;
  }
  EXPECT_EQ(backoff.next_wait(0.0, now), 15s) << "then the usual limit applies";
  backoff.reset();
  now += 1h;
  EXPECT_LE(backoff.next_wait(0.999, now), 500ms);
  for (int i = 0; i < 10; ++i) EXPECT_LE(backoff.next_wait(0.999, now), 3s) << "another outage";
}

}  // namespace
}  // namespace slamgw
