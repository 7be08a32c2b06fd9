// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/repeat_filter.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <vector>

namespace slamgw::ble {

namespace {

/// Lost first copies shift an arrival by as many repeat intervals: see may_be_new().
constexpr int earliest_shift = -2;
constexpr int latest_shift = 4;

/// Returns the distance of `time` from a whole number of periods, at least one.
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

namespace {

/// The time of each copy, in intervals after the first; 256 of the shortest are nearly 60 s.
constexpr std::array<int, 10> schedule{0, 1, 2, 4, 8, 16, 32, 64, 128, 256};
constexpr std::uint32_t any_copy = (1U << schedule.size()) - 1;
constexpr std::size_t max_lost = 3;
constexpr std::uint32_t first_heard_copies = (1U << (max_lost + 1)) - 1;

}  // namespace

RepeatFilter::Verdict RepeatFilter::on_set(ByteView payload, Duration interval, Doubt doubt,
                                           TimePoint now) {
  const bool is_equal = state_ != State::idle && !number_ && std::ranges::equal(payload, payload_);
  const Copies fitting = fitting_copies(last_copy_, interval, now);
  was_heard_ = false;
  if (is_equal && fitting == 0 && has_crossed(now)) {
    pattern_.on_repeat();
    return Verdict::repeat_open;
  }
  const Copies likely = is_equal ? fitting_copies(likely_copy_, interval, now) : 0;
  const bool is_likely_copy = likely != 0 || (is_equal && state_ == State::open);
  on_copy(is_likely_copy, is_equal, now);
  likely_copy_ = likely != 0 ? likely : is_likely_copy ? any_copy : first_heard_copies;
  const Duration gap = now - last_heard_;
  last_heard_ = now;
  if (is_equal && (state_ == State::open || is_repeat(fitting, interval, doubt, now))) {
    last_copy_ = fitting != 0 ? fitting : any_copy;
    last_gap_ = gap;
    pattern_.on_repeat();
    const Verdict verdict = on_repeat(now);
    answered_again_ += verdict == Verdict::repeat_answered ? 1 : 0;
    return verdict;
  }
  const bool is_evenly_spaced = is_equal && std::chrono::abs(gap - last_gap_) < tolerance;
  missed_ = is_evenly_spaced ? answered_again_ : 0;
  if (missed_ > 0) {
    pattern_.forget();
    is_schedule_deceptive_ = true;
  }
  pattern_.on_new(!is_equal || fitting == 0, now);
  open(payload, std::nullopt, now);
  last_gap_ = Duration::zero();
  last_copy_ = first_heard_copies;
  answered_again_ = 0;
  return Verdict::fresh;
}

RepeatFilter::Verdict RepeatFilter::on_numbered_set(std::uint8_t number, ByteView payload,
                                                    TimePoint now) {
  const bool is_same = state_ != State::idle && number_ == number &&
                       now - first_heard_ <= longest_exchange &&
                       std::ranges::equal(payload, payload_);
  on_copy(is_same, is_same, now);
  if (is_same) return on_repeat(now);
  open(payload, number, now);
  missed_ = 0;
  return Verdict::fresh;
}

void RepeatFilter::open(ByteView payload, std::optional<std::uint8_t> number, TimePoint now) {
  state_ = State::open;
  payload_.assign(payload.begin(), payload.end());
  number_ = number;
  first_heard_ = now;
}

/// A robot sends no other message of this model before the last one is acknowledged or given up.
/// Nordic's code gives up after half a minute and many copies, other firmware when the next message
/// is due.
void RepeatFilter::on_copy(bool is_copy, bool is_equal, TimePoint now) {
  was_heard_ = !is_copy && state_ == State::answered && unheard_copies_ == 0;
  // Equal messages at the robot's own period can look like a few repeats.
  if (was_heard_ || (is_equal && !is_copy)) unheard_messages_ = 0;
  if (!is_copy) unheard_copies_ = 0;
  const bool is_unheard = is_copy && state_ == State::answered && !has_crossed(now);
  if (is_unheard && unheard_copies_++ == 0) ++unheard_messages_;
}

RepeatFilter::Verdict RepeatFilter::on_repeat(TimePoint now) const {
  return state_ == State::open || has_crossed(now) ? Verdict::repeat_open
                                                   : Verdict::repeat_answered;
}

bool RepeatFilter::has_crossed(TimePoint now) const {
  return state_ == State::answered && now - last_answered_ < crossing_time;
}

bool RepeatFilter::is_repeat(Copies fitting, Duration interval, Doubt doubt, TimePoint now) const {
  if (fitting == 0) return false;
  // If the SET is new after all, the robot sends it again: nothing is lost or wrongly acknowledged.
  if (has_crossed(now)) return true;
  if (const auto period = pattern_.period()) return !pattern_.may_be_new(*period, interval, now);
  return doubt == Doubt::take_for_repeat && !is_schedule_deceptive_;
}

void RepeatFilter::on_answered(TimePoint now) {
  state_ = State::answered;
  last_answered_ = now;
}

RepeatFilter::Copies RepeatFilter::fitting_copies(Copies last_copy, Duration interval,
                                                  TimePoint now) const {
  if (now - first_heard_ > longest_exchange) return 0;
  const Duration gap = now - last_heard_;
  Copies fitting = 0;
  for (std::size_t last = 0; last < schedule.size(); ++last) {
    if ((last_copy >> last & 1U) == 0) continue;
    const std::size_t end = std::min(last + max_lost + 2, schedule.size());
    for (std::size_t next = last + 1; next < end; ++next) {
      const Duration expected = interval * (schedule[next] - schedule[last]);
      if (std::chrono::abs(gap - expected) < tolerance) fitting |= 1U << next;
    }
  }
  return fitting;
}

}  // namespace slamgw::ble
