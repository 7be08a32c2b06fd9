// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/flood_guard.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

bool TokenBucket::take(unsigned burst, unsigned per_second, TimePoint now) {
  const Duration one = std::chrono::nanoseconds(std::chrono::seconds{1}) / per_second;
  const TimePoint after = std::max(taken_until_, now) + one;
  if (after - now > one * burst) return false;
  taken_until_ = after;
  return true;
}

bool FloodGuard::may_answer(const Peer& peer, TimePoint now) {
  TokenBucket& source = sources_[PeerHash{}(peer) % places];
  return source.take(limits::stranger_burst, limits::stranger_per_second, now) &&
         all_.take(limits::strangers_burst, limits::strangers_per_second, now);
}

}  // namespace slamgw::mqttsn
