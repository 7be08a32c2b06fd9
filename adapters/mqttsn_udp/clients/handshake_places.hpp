// SPDX-License-Identifier: Apache-2.0
// The places for DTLS handshakes that are under way, limited in all, at one address, and in one
// network. When no place is free, the oldest handshake of the fullest address loses its place, so
// an attacker with many handshakes shuts out no robot. A handshake takes a few round trips and then
// leaves its place. Pure.
#pragma once

#include <cstdint>
#include <map>
#include <optional>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

class HandshakePlaces {
 public:
  /// Gives a place to `from`, which has none yet. Returns the handshake that lost its place, if
  /// any.
  std::optional<Endpoint> add(const Endpoint& from, TimePoint now);
  void remove(const Endpoint& from);
  /// Removes and returns a handshake that has taken too long.
  std::optional<Endpoint> take_overdue(TimePoint now);
  std::size_t size() const { return by_age_.size(); }

 private:
  struct Handshake {
    Endpoint from;
    TimePoint began;
  };

  Endpoint oldest_of_fullest(const IpAddress* network) const;

  std::map<std::uint64_t, Handshake> by_age_;  // at most max_dtls_handshakes
  std::uint64_t last_ = 0;
};

}  // namespace slamgw::mqttsn
