// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/retransmission_timeout.hpp"

#include <algorithm>

namespace slamgw::mqttsn {

Duration RetransmissionTimeout::first(Duration longest) const {
  return std::min(timeout_, longest);
}

Duration RetransmissionTimeout::next(Duration last, unsigned repeats, Duration longest) {
  constexpr unsigned even = 4;
  return std::min(repeats <= even ? last : last * 3 / 2, longest);
}

/// RFC 6298 section 2, with its alpha of 1/8 and beta of 1/4.
void RetransmissionTimeout::on_answer(Duration round_trip) {
  if (smoothed_ == Duration::zero()) {
    smoothed_ = std::max(round_trip, Duration{1});
    variation_ = round_trip / 2;
  } else {
    const Duration difference = std::chrono::abs(smoothed_ - round_trip);
    variation_ += (difference - variation_) / 4;
    smoothed_ += (round_trip - smoothed_) / 8;
  }
  timeout_ = std::max(learned(), shortest);
}

void RetransmissionTimeout::on_ambiguous_answer(Duration since_first, Duration since_last) {
  const bool answers_last_copy = smoothed_ != Duration::zero() && since_last <= learned();
  if (!answers_last_copy) timeout_ = std::clamp(since_first * 3 / 2, timeout_, 2 * timeout_);
}

Duration RetransmissionTimeout::learned() const {
  return smoothed_ + std::max(granularity, 4 * variation_);
}

}  // namespace slamgw::mqttsn
