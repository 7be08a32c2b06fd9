// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/answer_time.hpp"

#include <algorithm>
#include <chrono>

namespace slamgw::ble {

Duration AnswerTime::timeout(Duration longest) const {
  return timeout_ == Duration::zero() ? longest : std::min(timeout_, longest);
}

/// RFC 6298 section 2, with its alpha of 1/8 and beta of 1/4.
void AnswerTime::on_answer(Duration round_trip) {
  if (smoothed_ == Duration::zero()) {
    smoothed_ = std::max(round_trip, Duration{1});
    variation_ = round_trip / 2;
  } else {
    variation_ += (std::chrono::abs(smoothed_ - round_trip) - variation_) / 4;
    smoothed_ += (round_trip - smoothed_) / 8;
  }
  timeout_ = std::max(shortest_timeout, smoothed_ + std::max(granularity, 4 * variation_));
}

void AnswerTime::on_repeated() { timeout_ = std::min(2 * timeout_, longest_timeout); }

}  // namespace slamgw::ble
