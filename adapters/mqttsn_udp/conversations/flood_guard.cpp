// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/flood_guard.hpp"

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

bool FloodGuard::may_answer(const Peer& peer, TimePoint now) {
  TokenBucket& source = sources_[PeerHash{}(peer) % places];
  return source.take(limits::stranger_burst, limits::stranger_per_second, now) &&
         all_.take(limits::strangers_burst, limits::strangers_per_second, now);
}

}  // namespace slamgw::mqttsn
