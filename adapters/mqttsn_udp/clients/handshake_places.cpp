// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/handshake_places.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

std::optional<Endpoint> HandshakePlaces::add(const Endpoint& from, TimePoint now) {
  const IpAddress network = network_of(from.address);
  std::size_t at_address = 0;
  std::size_t in_network = 0;
  std::optional<Endpoint> oldest_at_address;
  for (const auto& [age, handshake] : by_age_) {
    if (network_of(handshake.from.address) == network) ++in_network;
    if (handshake.from.address != from.address) continue;
    ++at_address;
    if (!oldest_at_address) oldest_at_address = handshake.from;
  }
  std::optional<Endpoint> gives_way;
  if (at_address >= limits::max_dtls_handshakes_of_address) {
    gives_way = oldest_at_address;
  } else if (in_network >= limits::max_dtls_handshakes_of_network) {
    gives_way = oldest_of_fullest(&network);
  } else if (by_age_.size() >= limits::max_dtls_handshakes) {
    gives_way = oldest_of_fullest(nullptr);
  }
  if (gives_way) remove(*gives_way);
  by_age_.emplace(++last_, Handshake{from, now});
  return gives_way;
}

void HandshakePlaces::remove(const Endpoint& from) {
  std::erase_if(by_age_, [&](const auto& entry) { return entry.second.from == from; });
}

std::optional<Endpoint> HandshakePlaces::take_overdue(TimePoint now) {
  if (by_age_.empty() || now - by_age_.begin()->second.began < limits::dtls_handshake_patience)
    return std::nullopt;
  const Endpoint overdue = by_age_.begin()->second.from;
  by_age_.erase(by_age_.begin());
  return overdue;
}

/// Returns the oldest handshake of the fullest address in this network; null: in any network.
Endpoint HandshakePlaces::oldest_of_fullest(const IpAddress* network) const {
  std::map<IpAddress, std::size_t> sizes;
  std::size_t largest = 0;
  for (const auto& [age, handshake] : by_age_) {
    const IpAddress& address = handshake.from.address;
    if (!network || network_of(address) == *network) largest = std::max(largest, ++sizes[address]);
  }
  const auto oldest = std::ranges::find_if(by_age_, [&](const auto& entry) {
    const auto size = sizes.find(entry.second.from.address);
    return size != sizes.end() && size->second == largest;
  });
  return oldest->second.from;
}

}  // namespace slamgw::mqttsn
