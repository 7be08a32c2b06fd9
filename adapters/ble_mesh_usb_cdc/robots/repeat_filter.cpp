// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/repeat_filter.hpp"

#include <algorithm>
#include <array>
#include <chrono>

namespace slamgw::ble {
namespace {

/// When each copy is sent, in intervals after the first; 256 of the shortest are nearly 60 s.
constexpr std::array<int, 10> schedule{0, 1, 2, 4, 8, 16, 32, 64, 128, 256};
constexpr std::uint32_t any_copy = (1U << schedule.size()) - 1;
constexpr std::size_t max_lost = 3;
constexpr std::uint32_t first_heard_copies = (1U << (max_lost + 1)) - 1;

}  // namespace

RepeatFilter::Verdict RepeatFilter::on_set(ByteView payload, Duration interval, TimePoint now) {
  const Copies fitting = fitting_copies(interval, now);
  const bool is_equal = state_ != State::idle && std::ranges::equal(payload, payload_);
  const bool is_repeat = is_equal && (state_ == State::open || fitting != 0);
  last_heard_ = now;
  if (is_repeat) {
    last_copy_ = fitting != 0 ? fitting : any_copy;
    const bool has_crossed = now - last_answered_ < crossing_time;
    return state_ == State::open || has_crossed ? Verdict::repeat_open : Verdict::repeat_answered;
  }
  state_ = State::open;
  payload_.assign(payload.begin(), payload.end());
  first_heard_ = now;
  last_copy_ = first_heard_copies;
  return Verdict::fresh;
}

void RepeatFilter::on_answered(TimePoint now) {
  state_ = State::answered;
  last_answered_ = now;
}

RepeatFilter::Copies RepeatFilter::fitting_copies(Duration interval, TimePoint now) const {
  if (now - first_heard_ > longest_exchange) return 0;
  const Duration gap = now - last_heard_;
  Copies fitting = 0;
  for (std::size_t last = 0; last < schedule.size(); ++last) {
    if ((last_copy_ >> last & 1U) == 0) continue;
    const std::size_t end = std::min(last + max_lost + 2, schedule.size());
    for (std::size_t next = last + 1; next < end; ++next) {
      const Duration expected = interval * (schedule[next] - schedule[last]);
      if (std::chrono::abs(gap - expected) < tolerance) fitting |= 1U << next;
    }
  }
  return fitting;
}

}  // namespace slamgw::ble
