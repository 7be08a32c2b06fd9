// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/lease.hpp"

#include <algorithm>
#include <utility>

#include "daemon/fleet/peers.hpp"

namespace slamgw::fleet {

using std::chrono::milliseconds;

void Lease::begin_life(TimePoint now) {
  ++life_;
  life_began_ = joined_ = now;
  has_echo_ = false;
  until_ = {};
  dead_at_ = TimePoint::max();
}

bool Lease::on_own_beat(const Beat& beat, TimePoint now) {
  const auto now_ms = std::chrono::duration_cast<milliseconds>(now.time_since_epoch()).count();
  if (beat.sent_ms < 0 || beat.sent_ms > now_ms) return false;  // a forgery
  const TimePoint sent = now - milliseconds(now_ms - beat.sent_ms);
  const milliseconds wait(beat.period_ms);
  until_ = std::max(until_, sent + std::chrono::duration_cast<Duration>(wait * lease_periods));
  const TimePoint dead_at = sent + wait * death_periods;
  dead_at_ = has_echo_ ? std::max(dead_at_, dead_at) : dead_at;
  if (!std::exchange(has_echo_, true)) joined_ = now;
  return true;
}

}  // namespace slamgw::fleet
