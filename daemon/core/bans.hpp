// SPDX-License-Identifier: Apache-2.0
// The list of refused robots and hosts (`bans` of the configuration): robots by id or MQTT-SN
// client id, hosts by address or network. Immutable. Pure.
#pragma once

#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/ip_network.hpp"

namespace slamgw {

class Bans {
 public:
  /// Entries that are not valid are left out.
  explicit Bans(const std::vector<std::string>& entries = {});

  /// True for an address, also with a port or an interface, which are left out (`[fd00::1]:47193`,
  /// `fe80::1%wpan0`); a network (`fd00::/64`, `10.0.0.0/8`); or one topic level.
  static bool is_valid(std::string_view entry);

  /// True for equal texts, and for addresses and networks that cover the same hosts.
  static bool are_same(std::string_view entry, std::string_view other);

  bool has(std::string_view id) const { return ids_.contains(id); }
  bool covers(const IpNetwork::Address& address) const;
  const std::set<std::string, std::less<>>& ids() const { return ids_; }
  bool operator==(const Bans&) const = default;

 private:
  std::set<std::string, std::less<>> ids_;
  std::vector<IpNetwork> networks_;
};

}  // namespace slamgw
