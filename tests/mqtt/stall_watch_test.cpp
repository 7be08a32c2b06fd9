// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/stall_watch.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using Step = StallWatch::Step;

struct StallWatchTest : testing::Test {
  StallWatchTest() { watch.on_link_up(keep_alive, now); }
  Step pass(Duration time) { return watch.on_deadline(now += time); }

  static constexpr auto keep_alive = 30s;
  TimePoint now{1h};
  StallWatch watch;
};

TEST_F(StallWatchTest, AsksOnceAKeepAliveWhileNothingIsSent) {
  EXPECT_EQ(pass(keep_alive - 1s), Step::none);
  EXPECT_EQ(pass(1s), Step::ask);
  EXPECT_FALSE(watch.on_answer(now));
  EXPECT_EQ(watch.deadline(), now + keep_alive);
}

TEST_F(StallWatchTest, ReportsAnIdleSilentBrokerAsStalledWithinTwoKeepAlives) {
  for (const auto short_or_long : {1s, 2s, 5s, 30s, 600s}) {
    StallWatch idle;
    idle.on_link_up(short_or_long, now);
    TimePoint at = now;
    while (idle.on_deadline(at) != Step::stalled) at = *idle.deadline();
    EXPECT_LE(at - now, 2 * short_or_long);
  }
}

TEST_F(StallWatchTest, SendingAMessageBringsTheCheckForward) {
  EXPECT_TRUE(watch.on_sent());
  EXPECT_FALSE(watch.on_sent()) << "no later than before";
  EXPECT_EQ(watch.deadline(), now + StallWatch::interval);
  watch.on_link_down();
  EXPECT_FALSE(watch.deadline());
}

TEST_F(StallWatchTest, AsksOnceASecondWhileSomethingIsSent) {
  int questions = 0;
  for (int i = 0; i < 100; ++i) {
    watch.on_sent();
    if (pass(100ms) != Step::ask) continue;
    ++questions;
    EXPECT_FALSE(watch.on_answer(now));
  }
  EXPECT_GE(questions, 9);
  EXPECT_LE(questions, 10);
  pass(1s);
  watch.on_answer(now);
  EXPECT_EQ(watch.deadline(), now + keep_alive) << "the last answer came after all that was sent";
}

TEST_F(StallWatchTest, ChecksAgainForMessagesSentAfterTheQuestion) {
  watch.on_sent();
  ASSERT_EQ(pass(1s), Step::ask);
  watch.on_sent();
  watch.on_answer(now);
  EXPECT_EQ(watch.deadline(), now + StallWatch::interval);
}

TEST_F(StallWatchTest, ReportsABrokerAsSilentThenStalledWithinTenSeconds) {
  watch.on_sent();
  const TimePoint sent = now;
  ASSERT_EQ(pass(1s), Step::ask);
  EXPECT_EQ(pass(1s), Step::none);
  EXPECT_EQ(pass(1s), Step::silent);
  EXPECT_EQ(pass(1s), Step::none) << "reported once";
  EXPECT_EQ(pass(5s), Step::stalled);
  EXPECT_LT(now - sent, 10s);
}

TEST_F(StallWatchTest, AnAnswerEndsTheSilence) {
  watch.on_sent();
  pass(1s);
  ASSERT_EQ(pass(2s), Step::silent);
  EXPECT_TRUE(watch.on_answer(now));
  EXPECT_EQ(pass(10s), Step::none);
}

}  // namespace
}  // namespace slamgw
