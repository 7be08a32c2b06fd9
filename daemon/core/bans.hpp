// SPDX-License-Identifier: Apache-2.0
// The list of refused robots and hosts (`bans` of the configuration): robots by id or MQTT-SN
// client id, hosts by address or network. Immutable. Pure.
#pragma once

#include <array>
#include <cstdint>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace slamgw {

class Bans {
 public:
  /// IPv6, or IPv4 as ::ffff:a.b.c.d; network byte order.
  using Address = std::array<std::uint8_t, 16>;

  /// Entries that are not valid are left out.
  explicit Bans(const std::vector<std::string>& entries = {});

  /// An address, a network (`fd00::/64`, `10.0.0.0/8`), or one topic level.
  static bool is_valid(std::string_view entry);

  bool has(std::string_view id) const { return ids_.contains(id); }
  bool covers(const Address& address) const;
  const std::set<std::string, std::less<>>& ids() const { return ids_; }
  bool operator==(const Bans&) const = default;

 private:
  struct Network {
    Address address{};
    unsigned bits = 0;  ///< of the address that count
    bool operator==(const Network&) const = default;
  };

  std::set<std::string, std::less<>> ids_;
  std::vector<Network> networks_;
};

}  // namespace slamgw
