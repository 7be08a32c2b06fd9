// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/time.hpp"

#include <gtest/gtest.h>

namespace {

using namespace slamgw;
using namespace std::chrono_literals;

/// Expected texts are those of `date -u -d @SECONDS +%FT%TZ`.
TEST(Iso8601, IsUtcToTheSecondMillisecondOrMicrosecond) {
  EXPECT_EQ(to_iso8601(WallTime{}), "1970-01-01T00:00:00Z");
  EXPECT_EQ(to_iso8601(WallTime{1'700'000'000s}), "2023-11-14T22:13:20Z");
  EXPECT_EQ(to_iso8601(WallTime{1'709'210'096s}), "2024-02-29T12:34:56Z");
  EXPECT_EQ(to_iso8601_ms(WallTime{1'700'000'000s + 7999us}), "2023-11-14T22:13:20.007Z");
  EXPECT_EQ(to_iso8601_us(WallTime{1'700'000'000s + 42us}), "2023-11-14T22:13:20.000042Z");
}

TEST(Iso8601, RoundsDownBeforeTheEpochToo) {
  EXPECT_EQ(to_iso8601(WallTime{-1ms}), "1969-12-31T23:59:59Z");
  EXPECT_EQ(to_iso8601_ms(WallTime{-1ms}), "1969-12-31T23:59:59.999Z");
}

}  // namespace
