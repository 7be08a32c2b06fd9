// SPDX-License-Identifier: Apache-2.0
// A connection's client, as limits and the log see it: an IPv4 address, or the /64 of an IPv6
// address, because a host gets a whole /64 and can use each address in it. Pure.
#pragma once

#include <span>
#include <string>

namespace slamgw::web {

struct Client {
  std::string name;  ///< `192.0.2.7`, `2001:db8:0:1::/64`
  /// Behind a reverse proxy all clients come from loopback.
  bool is_loopback = false;
};

/// `address`: 4 or 16 octets. IPv4 addresses in IPv6's form (RFC 4291 section 2.5.5.2) are IPv4.
Client client_of(std::span<const unsigned char> address);

}  // namespace slamgw::web
