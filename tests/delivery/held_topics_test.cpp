// SPDX-License-Identifier: Apache-2.0
// Which held topic has the next try, where tries are rare.
#include "daemon/delivery/held_topics.hpp"

#include <gtest/gtest.h>

#include <string>

namespace slamgw {
namespace {

using namespace std::chrono_literals;

/// A broker that closes the connection after each refusal, and topics that it refuses for good.
class RefusedForGood : public testing::TestWithParam<int> {
 protected:
  void SetUp() override {
    for (int i = 0; i < GetParam(); ++i) {
      held.hold("r/1/" + std::to_string(i), {0x87, "no"}, 0, now);
      held.add(message("r/1/" + std::to_string(i), static_cast<std::uint64_t>(i) + 1));
    }
    held.on_loss_after_refusal(now);
  }
  static OutboxEntry message(const std::string& topic, std::uint64_t order) {
    OutboxEntry entry;
    entry.message = {topic, {}, Qos::at_least_once, false};
    entry.order = order;
    return entry;
  }
  /// Each is tried when its turn comes, and refused.
  void pass(Duration time) {
    for (const TimePoint end = now + time; now < end; now += 1s) {
      held.on_deadline(now);
      if (!held.next(now)) continue;
      OutboxEntry tried = held.take_next();
      held.on_published(tried.message.topic);
      held.on_answered(tried.message.topic, HeldTopics::Answer::refused);
      held.hold(tried.message.topic, {0x87, "no"}, 0, now);
      held.add(std::move(tried));
      held.on_loss_after_refusal(now);
      held.on_link_down();
      held.on_link_up(now);
    }
  }

  TopicCounts stored;
  HeldTopics held{stored};
  TimePoint now = TimePoint{} + 1h;
};

/// The messages of such a suspect are dropped until one has its trial.
TEST_P(RefusedForGood, DoNotKeepASuspectWithoutMessagesFromItsTrial) {
  pass(10min);
  held.suspect("r/2/stream", now);
  held.on_link_down();
  held.on_link_up(now);
  int seconds = 0;
  while (!held.wants_probe("r/2/stream") && ++seconds < 3600) pass(1s);
  EXPECT_LT(seconds, 120);
}

INSTANTIATE_TEST_SUITE_P(Topics, RefusedForGood, testing::Values(0, 1, 2, 5, 20));

}  // namespace
}  // namespace slamgw
