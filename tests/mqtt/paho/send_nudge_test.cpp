// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho/paho_link.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using std::chrono::milliseconds;

TEST(SendNudge, IsDueWhenNothingIsAcknowledgedWithMessagesInFlight) {
  SendNudge nudge;
  TimePoint now{std::chrono::hours(1)};
  EXPECT_FALSE(nudge.deadline());
  nudge.on_publish(now);
  nudge.on_publish(now += milliseconds(20));
  EXPECT_EQ(nudge.deadline(), now + SendNudge::first_wait);
  EXPECT_FALSE(nudge.take(now + milliseconds(24)));
  EXPECT_TRUE(nudge.take(now + milliseconds(25)));
}

TEST(SendNudge, NudgesSeldomForASlowBroker) {
  SendNudge nudge;
  TimePoint now{std::chrono::hours(1)};
  nudge.on_publish(now);
  int nudges = 0;
  for (const TimePoint end = now + std::chrono::seconds(10); now < end; now += milliseconds(5))
    nudges += nudge.take(now) ? 1 : 0;
  EXPECT_GE(nudges, 7);
  EXPECT_LE(nudges, 12);
  nudge.on_acknowledged(now);
  EXPECT_FALSE(nudge.deadline());
  nudge.on_publish(now);
  EXPECT_TRUE(nudge.take(now + milliseconds(25))) << "soon again after progress";
}

TEST(SendNudge, WaitsShorterForABrokerThatUsuallyAnswersQuickly) {
  SendNudge nudge;
  TimePoint now{std::chrono::hours(1)};
  for (int i = 0; i < 100; ++i) {
    nudge.on_publish(now);
    nudge.on_publish(now);
    nudge.on_acknowledged(now += milliseconds(1));
    nudge.on_acknowledged(now);
  }
  nudge.on_publish(now);
  EXPECT_LT(*nudge.deadline(), now + milliseconds(5));
  EXPECT_GE(*nudge.deadline(), now + SendNudge::shortest_wait);
}

TEST(SendNudge, IsNotDueForABrokerThatIsFarAway) {
  SendNudge nudge;
  TimePoint now{std::chrono::hours(1)};
  for (int i = 0; i < 100; ++i) {
    nudge.on_publish(now);
    nudge.on_acknowledged(now += milliseconds(20));
    EXPECT_FALSE(nudge.take(now));
  }
  nudge.on_publish(now);
  EXPECT_FALSE(nudge.take(now + milliseconds(24)));
}

TEST(PahoSequence, IsRestoredFromItsLowerHalf) {
  for (const std::uint64_t highest :
       {1ULL, 0x7fffffffULL, 0x80000001ULL, 0x100000002ULL, 0x300000000ULL})
    for (std::uint64_t sequence = highest - std::min<std::uint64_t>(highest, 512);
         sequence <= highest; ++sequence)
      EXPECT_EQ(restore_sequence(static_cast<std::uint32_t>(sequence), highest), sequence);
}

}  // namespace
}  // namespace slamgw
