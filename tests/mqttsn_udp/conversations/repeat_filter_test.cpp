// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/repeat_filter.hpp"

#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

Publish with_id(std::uint16_t msg_id) {
  return {false, WireQos::one, false, TopicIdType::normal, 1, msg_id, {}};
}

TEST(RepeatFilter, ARefusalOfWhatWasPushedOutTakesNothingElseAlong) {
  constexpr TimePoint now{std::chrono::hours(1)};
  RepeatFilter filter;
  for (std::uint64_t n = 1; n <= limits::max_repeats + 1; ++n)
    filter.add({n, now, n, 0, static_cast<std::uint16_t>(n)});
  ASSERT_EQ(filter.entries().size(), limits::max_repeats);
  EXPECT_EQ(filter.on_refused(1)->fingerprint, 1U);
  ASSERT_EQ(filter.entries().size(), limits::max_repeats);
  EXPECT_EQ(filter.entries().front().fingerprint, 2U);
  EXPECT_NE(filter.find(with_id(2), 2, now), nullptr);
  EXPECT_EQ(filter.on_refused(3)->fingerprint, 3U);
  EXPECT_EQ(filter.entries().size(), limits::max_repeats - 1);
  EXPECT_EQ(filter.find(with_id(3), 3, now), nullptr);
}

}  // namespace
}  // namespace slamgw::mqttsn
