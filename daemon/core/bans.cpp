// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bans.hpp"

#include <algorithm>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

Bans::Bans(const std::vector<std::string>& entries) {
  for (const std::string& entry : entries) {
    if (const auto network = IpNetwork::parse(entry)) {
      networks_.push_back(*network);
    } else if (is_valid_level(entry)) {
      ids_.insert(entry);
    }
  }
}

bool Bans::is_valid(std::string_view entry) {
  return IpNetwork::parse(entry) || is_valid_level(entry);
}

bool Bans::are_same(std::string_view entry, std::string_view other) {
  const auto network = IpNetwork::parse(entry);
  return network ? network == IpNetwork::parse(other) : entry == other;
}

bool Bans::covers(const IpNetwork::Address& address) const {
  return std::ranges::any_of(networks_,
                             [&](const IpNetwork& network) { return network.covers(address); });
}

}  // namespace slamgw
