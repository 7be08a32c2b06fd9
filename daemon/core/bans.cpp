// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bans.hpp"

#include <algorithm>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw {
namespace {

/// Also reads an address with a port or an interface, as `robots` and the journal show it:
/// `[fe80::1%4]:47193`, `10.0.0.7:47193`.
std::optional<IpNetwork> network_of(std::string_view entry) {
  std::string_view host = entry;
  if (host.find('/') != host.npos) return IpNetwork::parse(host);
  if (host.starts_with('[')) {
    host = host.substr(1, host.find(']') - 1);
  } else if (std::ranges::count(host, ':') == 1) {
    host = host.substr(0, host.find(':'));
  }
  return IpNetwork::parse(host.substr(0, host.find('%')));
}

}  // namespace

Bans::Bans(const std::vector<std::string>& entries) {
  for (const std::string& entry : entries) {
    if (const auto network = network_of(entry)) {
      networks_.push_back(*network);
    } else if (is_valid_level(entry)) {
      ids_.insert(entry);
    }
  }
}

bool Bans::is_valid(std::string_view entry) { return network_of(entry) || is_valid_level(entry); }

bool Bans::are_same(std::string_view entry, std::string_view other) {
  const auto network = network_of(entry);
  return network ? network == network_of(other) : entry == other;
}

bool Bans::covers(const IpNetwork::Address& address) const {
  return std::ranges::any_of(networks_,
                             [&](const IpNetwork& network) { return network.covers(address); });
}

}  // namespace slamgw
