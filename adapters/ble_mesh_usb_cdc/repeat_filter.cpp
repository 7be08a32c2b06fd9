// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/repeat_filter.hpp"

#include <algorithm>

namespace slamgw::ble {
namespace {

constexpr int max_doublings = 8;  // 256 times the shortest interval, 200 ms, is nearly 60 s

}  // namespace

RepeatFilter::Verdict RepeatFilter::on_set(ByteView payload, Duration interval, TimePoint now) {
  const bool is_equal = std::ranges::equal(payload, payload_);
  const bool is_repeat =
      state_ != State::idle && is_equal && (is_on_schedule(interval, now) || state_ == State::open);
  last_heard_ = now;
  if (is_repeat) {
    const bool has_crossed = now - last_answered_ < crossing_time;
    return state_ == State::open || has_crossed ? Verdict::repeat_open : Verdict::repeat_answered;
  }
  state_ = State::open;
  payload_.assign(payload.begin(), payload.end());
  first_heard_ = now;
  doublings_ = 0;
  single_gaps_ = 0;
  return Verdict::fresh;
}

void RepeatFilter::on_answered(TimePoint now) {
  state_ = State::answered;
  last_answered_ = now;
}

bool RepeatFilter::is_on_schedule(Duration interval, TimePoint now) {
  if (now - first_heard_ > longest_exchange) return false;
  const Duration gap = now - last_heard_;
  for (int doublings = doublings_; doublings <= max_doublings; ++doublings) {
    const Duration expected = interval * (1 << doublings);
    if (gap < expected - tolerance || gap > expected + tolerance) continue;
    if (doublings == 0 && ++single_gaps_ > 2) return false;
    doublings_ = doublings == 0 ? 0 : doublings + 1;
    return true;
  }
  return false;
}

}  // namespace slamgw::ble
