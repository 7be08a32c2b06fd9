// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/repeat_filter.hpp"

#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

Publish with_id(std::uint16_t msg_id) {
  return {false, WireQos::one, false, TopicIdType::normal, 1, msg_id, {}};
}

TEST(RepeatFilter, ForgetsTheOldestAcknowledgedMessageWhenFull) {
  constexpr TimePoint now{std::chrono::hours(1)};
  RepeatFilter filter;
  for (std::uint64_t n = 1; n <= limits::max_repeats + 1; ++n) {
    const bool is_open = n == 1 || n == 3;
    filter.add({n, now, is_open ? n : 0, 0, static_cast<std::uint16_t>(n)});
  }
  ASSERT_EQ(filter.entries().size(), limits::max_repeats);
  EXPECT_EQ(filter.entries()[0].fingerprint, 1U);
  EXPECT_EQ(filter.entries()[1].fingerprint, 3U) << "the second message is forgotten";
  EXPECT_NE(filter.find(with_id(3), 3, now), nullptr);
  EXPECT_TRUE(filter.on_refused(3));
  EXPECT_FALSE(filter.on_refused(3));
  EXPECT_EQ(filter.entries().size(), limits::max_repeats - 1);
  EXPECT_EQ(filter.find(with_id(3), 3, now), nullptr);
  EXPECT_TRUE(filter.on_safe(1, now));
  EXPECT_FALSE(filter.on_safe(1, now));
}

TEST(RepeatFilter, ForgetsOldMessagesBehindAnExchangeThatStaysOpen) {
  TimePoint now{std::chrono::hours(1)};
  RepeatFilter filter;
  filter.add({1, now, 0, 0, 1, 0, /*awaits_pubrel=*/true});
  for (std::uint16_t n = 2; n < 100; ++n) {
    filter.add({n, now, 0, 0, n});
    now += limits::repeat_window / 2;
    filter.find(with_id(0), 0, now);
  }
  EXPECT_LE(filter.entries().size(), 4U);
  EXPECT_TRUE(filter.entries().front().awaits_pubrel);
  EXPECT_TRUE(filter.on_pubrel(1, now));
}

}  // namespace
}  // namespace slamgw::mqttsn
