// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho/paho_link.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>

namespace slamgw {
namespace {

TEST(Handover, WakesTheConsumerOnceForItemsThatCameBeforeItTakesThem) {
  Handover<int> handover;
  EXPECT_EQ(handover.give(1), 1u);
  EXPECT_EQ(handover.give(2), 2u);
  EXPECT_EQ(handover.take(), (std::vector{1, 2}));
  EXPECT_TRUE(handover.take().empty());
  EXPECT_EQ(handover.give(3), 1u);
}

TEST(Handover, LosesNothingBetweenThreads) {
  constexpr int count = 20000;
  Handover<int> handover;
  std::atomic<int> wake_ups = 0;
  std::thread giver([&] {
    for (int i = 0; i < count; ++i) {
      if (handover.give(i) == 1) ++wake_ups;
    }
  });
  int expected = 0;
  int takes = 0;
  while (expected < count) {
    const std::vector<int> taken = handover.take();
    if (!taken.empty()) ++takes;
    for (const int item : taken) ASSERT_EQ(item, expected++);
  }
  giver.join();
  EXPECT_EQ(wake_ups, takes);
}

}  // namespace
}  // namespace slamgw
