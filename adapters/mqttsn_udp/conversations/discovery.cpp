// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/discovery.hpp"

#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

bool FloodGuard::may_answer(const Peer& peer, TimePoint now) {
  TokenBucket& source = sources_[PeerHash{}(peer) % places];
  return source.take(limits::stranger_burst, limits::stranger_per_second, now) &&
         all_.take(limits::strangers_burst, limits::strangers_per_second, now);
}

/// Answers the source by unicast: a multicast GWINFO misses clients on other ports, behind routers,
/// and sleepy ones (R15).
void Discovery::on_searchgw(const Arrival& arrival, std::uint8_t radius) {
  if (!is_broker_up_ || !clients_.has_room(arrival.peer, arrival.now)) return;  // R20
  if (!guard_.may_answer(arrival.peer, arrival.now)) return output_.count(Count::unanswered);
  output_.send(arrival.peer, arrival.local, GwInfo{settings_.gateway_id, {}}, radius);
}

void Discovery::on_broker_link(bool is_up, TimePoint now) {
  if (std::exchange(is_broker_up_, is_up) == is_up) return;
  next_advertise_.reset();
  if (is_up && is_advertised()) advertise(now);
}

void Discovery::on_interface(std::uint32_t index) {
  if (is_broker_up_ && is_advertised()) output_.send_multicast(advertisement(), index);
}

/// Returns false if all clients must use DTLS: an ADVERTISE leads them to the port for plain UDP.
bool Discovery::is_advertised() const {
  return settings_.multicast_group && settings_.require_identity != RequireIdentity::all;
}

void Discovery::on_deadline(TimePoint now) {
  if (next_advertise_ && *next_advertise_ <= now) advertise(now);
}

void Discovery::advertise(TimePoint now) {
  output_.send_multicast(advertisement());
  next_advertise_ = now + settings_.advertise_interval;
}

Advertise Discovery::advertisement() const {
  const auto interval = settings_.advertise_interval.count();
  return {settings_.gateway_id, static_cast<std::uint16_t>(interval)};
}

}  // namespace slamgw::mqttsn
