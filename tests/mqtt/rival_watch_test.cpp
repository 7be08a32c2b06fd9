// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/backoff.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TEST(RivalWatch, ReportsARivalAtOnceWhenTheBrokerNamesIt) {
  RivalWatch watch;
  watch.on_up(TimePoint{0s});
  EXPECT_TRUE(watch.on_lost(true, false, TimePoint{1h}));
  EXPECT_EQ(watch.pause(), RivalWatch::first_pause);
}

TEST(RivalWatch, ReportsARivalWhenConnectionsEndSoonRepeatedly) {
  RivalWatch watch;
  watch.on_up(TimePoint{0s});
  EXPECT_FALSE(watch.on_lost(false, false, TimePoint{1s})) << "a broker that restarts";
  EXPECT_EQ(watch.pause(), 0s);
  watch.on_up(TimePoint{2s});
  EXPECT_TRUE(watch.on_lost(false, false, TimePoint{3s}));
}

/// The outbox finds a message for which the broker closes the connection by sending it again;
/// pauses would delay all other messages.
TEST(RivalWatch, ReportsNoRivalForALossWithMessagesUnderWay) {
  RivalWatch watch;
  for (int second = 0; second < 8; second += 2) {
    watch.on_up(TimePoint{std::chrono::seconds(second)});
    EXPECT_FALSE(watch.on_lost(false, true, TimePoint{std::chrono::seconds(second + 1)}));
    EXPECT_EQ(watch.pause(), 0s);
  }
}

/// Both gateways watch, and each takes over after its own pause.
TEST(RivalWatch, TwoGatewaysTakeOverFromEachOtherAfterGrowingPauses) {
  RivalWatch watch;
  TimePoint now{0s};
  std::size_t takeovers = 0;
  Duration before = 0s;
  while (now < TimePoint{1h}) {
    watch.on_up(now);
    now += std::max<Duration>(watch.pause(), 1s);  // the rival's pause is as long as ours
    ASSERT_TRUE(watch.on_lost(true, false, now));
    EXPECT_GE(watch.pause(), before);
    before = watch.pause();
    now += watch.pause();
    ++takeovers;
  }
  EXPECT_EQ(watch.pause(), RivalWatch::longest_pause);
  EXPECT_LE(takeovers, 20u) << "an hour";
}

TEST(RivalWatch, ForgetsTheRivalWhenAConnectionLasts) {
  RivalWatch watch;
  watch.on_up(TimePoint{0s});
  watch.on_lost(true, false, TimePoint{1s});
  watch.on_up(TimePoint{3s});
  EXPECT_FALSE(watch.on_lost(false, false, TimePoint{1h}));
  EXPECT_EQ(watch.pause(), 0s);
}

}  // namespace
}  // namespace slamgw
