// SPDX-License-Identifier: Apache-2.0
// One datagram as sendmsg(2) and sendmmsg(2) want it: the address that it goes to, the local
// address that it leaves from, and its octets.
#pragma once

#include <netinet/in.h>
#include <sys/socket.h>

#include <array>
#include <cstdint>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/bytes.hpp"

namespace slamgw::mqttsn {

/// Points into itself: filled in where it stays.
class OutgoingDatagram {
 public:
  OutgoingDatagram() = default;
  OutgoingDatagram(const OutgoingDatagram&) = delete;
  OutgoingDatagram& operator=(const OutgoingDatagram&) = delete;

  /// `is_ipv6_socket`: IPv4 addresses are IPv4-mapped there, and IPv6 ones unusable elsewhere.
  void fill(bool is_ipv6_socket, const Endpoint& to, const IpAddress& from, std::uint32_t interface,
            Bytes bytes);
  /// For another attempt: the kernel chooses the interface. False when it does already.
  bool forget_interface();
  const msghdr& header() const { return header_; }

 private:
  void write_target(const Endpoint& to);
  void write_source();

  bool is_ipv6_socket_ = false;
  bool is_to_ipv4_ = false;
  IpAddress from_{};
  std::uint32_t interface_ = 0;
  sockaddr_in6 target_{};  // large enough for sockaddr_in
  alignas(cmsghdr) std::array<std::uint8_t, CMSG_SPACE(sizeof(in6_pktinfo))> control_{};
  Bytes bytes_;
  iovec part_{};
  msghdr header_{};
};

}  // namespace slamgw::mqttsn
