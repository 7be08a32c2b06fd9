// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/round_trip.hpp"

#include <algorithm>
#include <chrono>

namespace slamgw {

/// Uses an alpha of 1/8 and a beta of 1/4.
void RoundTrip::on_answer(Duration round_trip) {
  if (!is_known()) {
    smoothed_ = std::max(round_trip, Duration{1});
    variation_ = round_trip / 2;
    return;
  }
  variation_ += (std::chrono::abs(smoothed_ - round_trip) - variation_) / 4;
  smoothed_ += (round_trip - smoothed_) / 8;
}

Duration RoundTrip::timeout() const { return smoothed_ + std::max(granularity_, 4 * variation_); }

}  // namespace slamgw
