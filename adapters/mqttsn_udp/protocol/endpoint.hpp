// SPDX-License-Identifier: Apache-2.0
// The remote and the local address of a datagram: plain values that the machine keeps and compares,
// and that the shell turns into socket addresses.
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

// IP addresses as plain values, their kinds, and the choice of our source address for a message
// (R16). IPv4 addresses are IPv4-mapped (::ffff:a.b.c.d). Pure functions.

/// An IP address in network byte order. All zero stands for no particular address.
using IpAddress = std::array<std::uint8_t, 16>;

bool is_ipv4(const IpAddress& address);
/// Also true for IPv4's limited broadcast, 255.255.255.255.
bool is_multicast(const IpAddress& address);
bool is_link_local(const IpAddress& address);
/// Returns the /64 of an IPv6 address, and an IPv4 address itself.
IpAddress network_of(IpAddress address);
/// Returns true for an RLOC or ALOC (interface identifier 0000:00ff:fe00:xxxx). Routing changes it,
/// and OpenThread does not pass datagrams to it on to the host.
bool is_thread_locator(const IpAddress& address);

/// Chooses the source for a message to `to` (unicast or multicast) among an interface's addresses:
/// never a locator; link-local only towards link-local scope; then the longest common prefix. For a
/// multicast, Thread's mesh-local EID comes first, because every robot can reach it. Returns all
/// zero if the kernel may choose, nothing if it would have to choose a locator.
std::optional<IpAddress> choose_source(const std::vector<IpAddress>& candidates,
                                       const IpAddress& to);

/// `fd00::1`, `192.0.2.7`.
std::string to_string(const IpAddress& address);

/// Address of the remote side.
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
  std::uint8_t socket = 0;      ///< index in `mqttsn.listen` or `mqttsn.dtls.listen`
  auto operator<=>(const LocalAddress&) const = default;
};

/// A client's transport address: behind a forwarder it includes the wireless node id (R139), over
/// DTLS the identity.
struct Peer {
  Endpoint endpoint;
  std::string node_id;  ///< empty: not encapsulated
  /// The MQTT-SN client id that a key has proven over DTLS; empty: over plain UDP.
  std::string identity{};
  auto operator<=>(const Peer&) const = default;
};

/// The source, the local address and the time of a message.
struct Arrival {
  Peer peer;
  LocalAddress local;
  std::uint64_t fingerprint = 0;  ///< of its octets
  TimePoint now{};
};

struct SendDatagram {
  LocalAddress from;
  Endpoint to;
  Bytes bytes;
  std::string identity{};  ///< see Peer
};

struct PeerHash {
  std::size_t operator()(const Peer& peer) const;
};

/// `[fd00::1]:47193`, `192.0.2.7:47193`, with `via <node id in hex>` behind a forwarder,
/// and `over DTLS`.
std::string to_string(const Peer& peer);

}  // namespace slamgw::mqttsn
