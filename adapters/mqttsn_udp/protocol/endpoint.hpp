// SPDX-License-Identifier: Apache-2.0
// Where a datagram came from and where it arrived: plain values that the machine keeps and
// compares, and the shell turns into socket addresses.
#pragma once

#include <compare>
#include <cstdint>
#include <string>

#include "adapters/mqttsn_udp/protocol/ip_address.hpp"
#include "daemon/core/bytes.hpp"

namespace slamgw::mqttsn {

/// The other side.
struct Endpoint {
  IpAddress address{};
  std::uint16_t port = 0;
  std::uint32_t scope_id = 0;  ///< of link-local addresses where several interfaces are served
  auto operator<=>(const Endpoint&) const = default;
};

/// Our side: an answer leaves from the address and socket that the request came to (R17).
struct LocalAddress {
  IpAddress address{};          ///< all zero: the kernel chooses
  std::uint32_t interface = 0;  ///< index; 0: any
  std::uint8_t socket = 0;      ///< which of `mqttsn.listen`
  auto operator<=>(const LocalAddress&) const = default;
};

/// A client's transport address: behind a forwarder it includes the wireless node id (R139).
struct Peer {
  Endpoint endpoint;
  std::string node_id;  ///< empty: not encapsulated
  auto operator<=>(const Peer&) const = default;
};

struct SendDatagram {
  LocalAddress from;
  Endpoint to;
  Bytes bytes;
};

struct PeerHash {
  std::size_t operator()(const Peer& peer) const;
};

/// `[fd00::1]:47193`, `192.0.2.7:47193`, with `via <node id in hex>` behind a forwarder.
std::string to_string(const Peer& peer);

}  // namespace slamgw::mqttsn
