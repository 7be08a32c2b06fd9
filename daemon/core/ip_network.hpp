// SPDX-License-Identifier: Apache-2.0
// A network of IP addresses as the configuration writes it: `fd00::/64`, `10.0.0.0/8`, or a single
// address. Pure.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

namespace slamgw {

struct IpNetwork {
  /// IPv6, or IPv4 as ::ffff:a.b.c.d; network byte order.
  using Address = std::array<std::uint8_t, 16>;

  /// Returns nothing for text that is neither an address nor a network.
  static std::optional<IpNetwork> parse(std::string_view text);
  bool covers(const Address& other) const;
  bool operator==(const IpNetwork&) const = default;

  Address address{};    ///< zero after the leading bits, so that equal networks have equal values
  unsigned bits = 128;  ///< leading bits of `address` that count
};

}  // namespace slamgw
