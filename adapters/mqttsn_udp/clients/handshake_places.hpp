// SPDX-License-Identifier: Apache-2.0
// Which DTLS handshake gives way to a new one. Handshakes under way are bounded in all, at one
// address, and in one network. When no place is free, the oldest handshake of the fullest address
// ends, so an attacker with many handshakes at few addresses shuts out no robot. And which one has
// taken too long. Pure.
#pragma once

#include <algorithm>
#include <map>
#include <optional>
#include <tuple>

#include "adapters/mqttsn_udp/limits.hpp"
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

/// Returns the handshake that must end before one from `newcomer` begins, if there is no place.
/// `Handshakes` is a map from Endpoint to a value with the time `began`.
template <class Handshakes>
std::optional<Endpoint> find_handshake_to_end(const Handshakes& handshakes,
                                              const IpAddress& newcomer) {
  std::map<IpAddress, std::size_t> at_address;
  std::map<IpAddress, std::size_t> in_network;
  for (const auto& each : handshakes) {
    ++at_address[each.first.address];
    ++in_network[network_of(each.first.address)];
  }
  const IpAddress network = network_of(newcomer);
  const bool is_address_full = at_address[newcomer] >= limits::max_dtls_handshakes_of_address;
  const bool is_network_full = in_network[network] >= limits::max_dtls_handshakes_of_network;
  const bool is_full = handshakes.size() >= limits::max_dtls_handshakes;
  if (!is_address_full && !is_network_full && !is_full) return std::nullopt;
  const auto rank = [&](const auto& each) {
    const IpAddress& address = each.first.address;
    const bool competes =
        is_address_full ? address == newcomer : !is_network_full || network_of(address) == network;
    return std::tuple(competes, at_address[address], TimePoint::max() - each.second.began);
  };
  return std::ranges::max_element(handshakes, {}, rank)->first;
}

/// Returns a handshake that has taken limits::dtls_handshake_patience, if there is one.
template <class Handshakes>
std::optional<Endpoint> find_overdue_handshake(const Handshakes& handshakes, TimePoint now) {
  const auto overdue = std::ranges::find_if(handshakes, [now](const auto& each) {
    return now - each.second.began >= limits::dtls_handshake_patience;
  });
  return overdue == handshakes.end() ? std::nullopt : std::optional(overdue->first);
}

}  // namespace slamgw::mqttsn
