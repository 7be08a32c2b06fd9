// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/lease.hpp"

#include <algorithm>
#include <utility>

#include "daemon/fleet/peers.hpp"

namespace slamgw::fleet {

using std::chrono::milliseconds;

void Lease::begin_life(TimePoint now) {
  look(now);
  ++life_;
  life_began_ = joined_ = now;
  has_echo_ = is_hearing_ = false;
  until_ = {};
  dead_at_ = TimePoint::max();
}

void Lease::on_gap(TimePoint now) {
  is_hearing_ = false;
  gap_ended_ = now;
}

bool Lease::is_possible(const Beat& beat, TimePoint now) {
  return beat.sent_ms >= 0 && beat.sent_ms <= to_clock_ms(now);
}

void Lease::look(TimePoint now) {
  if (std::exchange(is_held_, is_valid(now)) && !is_held_) ++lapses_;
}

void Lease::on_own_beat(const Beat& beat, TimePoint now) {
  look(now);
  const TimePoint sent = now - milliseconds(to_clock_ms(now) - beat.sent_ms);
  const milliseconds wait(beat.period_ms);
  until_ = std::max(until_, sent + std::chrono::duration_cast<Duration>(wait * lease_periods));
  const TimePoint dead_at = sent + wait * death_periods;
  dead_at_ = has_echo_ ? std::max(dead_at_, dead_at) : dead_at;
  is_held_ = is_valid(now);
  if (!std::exchange(has_echo_, true)) joined_ = now;
  if (!std::exchange(is_hearing_, true)) gap_ended_ = now;
}

}  // namespace slamgw::fleet
