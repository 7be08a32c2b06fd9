// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_numbers.hpp"

#include <algorithm>
#include <limits>

namespace slamgw {
namespace {

constexpr std::chrono::seconds rate_window{5};

}  // namespace

void RateMeter::on_message(TimePoint now) {
  if (now - window_start_ >= rate_window) {
    in_previous_ = now - window_start_ < 2 * rate_window ? in_window_ : 0;
    in_window_ = 0;
    window_start_ = now;
  }
  ++in_window_;
}

double RateMeter::per_second(TimePoint now) const {
  const auto age = now - window_start_;
  if (age >= 2 * rate_window) return 0;
  const std::chrono::duration<double> covered = rate_window + age;
  return (in_previous_ + in_window_) / covered.count();
}

LatencyWindow::Stamp LatencyWindow::stamp(TimePoint now) {
  return static_cast<Stamp>(
      std::chrono::duration_cast<std::chrono::milliseconds>(now.time_since_epoch()).count());
}

void LatencyWindow::add(std::chrono::microseconds latency, TimePoint now) {
  constexpr std::int64_t longest = std::numeric_limits<std::uint32_t>::max();
  const auto bounded =
      static_cast<std::uint32_t>(std::clamp<std::int64_t>(latency.count(), 0, longest));
  if (samples_.size() < max_samples) {
    samples_.push_back({bounded, stamp(now)});
  } else {
    samples_[next_] = {bounded, stamp(now)};
    next_ = (next_ + 1) % max_samples;
  }
}

std::optional<LatencyWindow::Percentiles> LatencyWindow::percentiles(TimePoint now) const {
  constexpr Stamp length_ms = std::chrono::milliseconds(length).count();
  const Stamp end = stamp(now);
  std::vector<std::uint32_t> recent;
  recent.reserve(samples_.size());
  for (const Sample& sample : samples_)
    if (end - sample.at < length_ms) recent.push_back(sample.latency_us);
  if (recent.empty()) return std::nullopt;
  // Selects instead of sorting: this runs for a thousand busy robots at once, while messages wait.
  const auto rank = [&](std::size_t percent) {  // nearest rank
    return recent.begin() + static_cast<std::ptrdiff_t>((recent.size() * percent + 99) / 100 - 1);
  };
  std::ranges::nth_element(recent, rank(99));
  std::ranges::nth_element(recent.begin(), rank(50), rank(99) + 1);
  return Percentiles{std::chrono::microseconds(*rank(50)), std::chrono::microseconds(*rank(99))};
}

void LatencyHistogram::add(std::chrono::microseconds latency) {
  for (std::size_t i = 0; i < bounds_us.size(); ++i)
    at_most_[i] += latency.count() <= bounds_us[i] ? 1 : 0;
  ++count_;
  sum_ += latency;
}

void RobotNumbers::on_up(std::size_t bytes, TimePoint now) {
  if (up_ > 0) note_interval(now - last_up_);
  last_up_ = now;
  ++up_;
  bytes_up_ += bytes;
  rate_.on_message(now);
}

void RobotNumbers::on_down(std::size_t bytes) {
  ++down_;
  bytes_down_ += bytes;
}

void RobotNumbers::note_interval(Duration interval) {
  constexpr int share = 16;        // of one interval in the average
  if (interval < at_once) return;  // the messages were read together
  if (usual_interval_ == Duration::zero()) usual_interval_ = interval;
  const Duration longest = gap_factor * usual_interval_;
  if (up_ >= messages_to_know && interval > longest) ++gaps_;
  usual_interval_ += (std::min(interval, longest) - usual_interval_) / share;
}

}  // namespace slamgw
