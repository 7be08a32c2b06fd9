// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/arrival_pattern.hpp"

#include <algorithm>
#include <chrono>
#include <vector>

namespace slamgw::ble {
namespace {

/// Lost first copies shift an arrival by as many repeat intervals: see may_be_new().
constexpr int earliest_shift = -2;
constexpr int latest_shift = 4;

/// How far `time` is from a whole number of periods, at least one.
Duration distance(Duration time, Duration period) {
  const auto periods = std::max<Duration::rep>(1, (time + period / 2) / period);
  return std::chrono::abs(time - periods * period);
}

}  // namespace

void ArrivalPattern::on_new(bool is_certain, TimePoint now) {
  const Duration gap = last_new_ ? now - *last_new_ : Duration::zero();
  if (gap > longest_gap) {
    gaps_.clear();
  } else if (is_certain && is_last_certain_ && gap > Duration::zero()) {
    gaps_.push_back(gap);
    if (gaps_.size() > max_gaps) gaps_.pop_front();
  }
  last_new_ = now;
  is_last_certain_ = is_certain;
}

void ArrivalPattern::forget() {
  gaps_.clear();
  last_new_.reset();
  is_last_certain_ = false;
}

std::optional<Duration> ArrivalPattern::period() const {
  if (gaps_.size() < min_gaps) return std::nullopt;
  std::vector<Duration> gaps(gaps_.begin(), gaps_.end());
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::ranges::nth_element(gaps, middle);
  const Duration median = *middle;
  std::size_t regular_gaps = 0;
  for (const Duration gap : gaps) {
    const Duration error = distance(gap, median);
    if (error > regular && error < lost) return std::nullopt;
    regular_gaps += error <= regular ? 1 : 0;
  }
  if (2 * regular_gaps <= gaps.size()) return std::nullopt;
  return median;
}

bool ArrivalPattern::may_be_new(Duration period, Duration repeat_interval, TimePoint now) const {
  if (!last_new_) return true;
  for (int shift = earliest_shift; shift <= latest_shift; ++shift)
    if (distance(now - *last_new_ - shift * repeat_interval, period) <= tolerance) return true;
  return false;
}

}  // namespace slamgw::ble
