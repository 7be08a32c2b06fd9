// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/outgoing_datagram.hpp"

#include <cstring>
#include <utility>

#include "daemon/core/spare_buffers.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr std::size_t ipv4_offset = 12;  // in an IPv4-mapped address

template <class Info>
void write_control(msghdr& header, int level, int type, const Info& info) {
  header.msg_controllen = CMSG_SPACE(sizeof info);
  cmsghdr* c = CMSG_FIRSTHDR(&header);
  c->cmsg_level = level;
  c->cmsg_type = type;
  c->cmsg_len = CMSG_LEN(sizeof info);
  std::memcpy(CMSG_DATA(c), &info, sizeof info);
}

}  // namespace

void OutgoingDatagram::fill(bool is_ipv6_socket, const Endpoint& to, const IpAddress& from,
                            std::uint32_t interface, Bytes bytes) {
  is_ipv6_socket_ = is_ipv6_socket;
  is_to_ipv4_ = is_ipv4(to.address);
  from_ = from;
  interface_ = interface;
  SpareBuffers<Bytes>::give_back(std::exchange(bytes_, std::move(bytes)));
  part_ = {bytes_.data(), bytes_.size()};
  header_ = {};
  header_.msg_iov = &part_;
  header_.msg_iovlen = 1;
  write_target(to);
  write_source();
}

bool OutgoingDatagram::forget_interface() {
  if (std::exchange(interface_, 0) == 0) return false;
  write_source();
  return true;
}

void OutgoingDatagram::write_target(const Endpoint& to) {
  header_.msg_name = &target_;
  if (!is_ipv6_socket_) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(to.port);
    std::memcpy(&address.sin_addr, to.address.data() + ipv4_offset, sizeof address.sin_addr);
    std::memcpy(&target_, &address, sizeof address);
    header_.msg_namelen = sizeof address;
    return;
  }
  target_ = {};
  target_.sin6_family = AF_INET6;
  target_.sin6_port = htons(to.port);
  target_.sin6_scope_id = is_to_ipv4_ ? 0 : to.scope_id;
  std::memcpy(&target_.sin6_addr, to.address.data(), to.address.size());
  header_.msg_namelen = sizeof target_;
}

void OutgoingDatagram::write_source() {
  if (from_ == IpAddress{} && interface_ == 0) {
    header_.msg_control = nullptr;
    header_.msg_controllen = 0;
    return;
  }
  header_.msg_control = control_.data();
  header_.msg_controllen = control_.size();
  if (is_ipv6_socket_) {
    in6_pktinfo info{};
    std::memcpy(&info.ipi6_addr, from_.data(), from_.size());
    if (is_to_ipv4_ && from_ == IpAddress{}) {  // "any source" must be an IPv4 address then
      info.ipi6_addr.s6_addr[10] = info.ipi6_addr.s6_addr[11] = 0xff;
    }
    info.ipi6_ifindex = interface_;
    return write_control(header_, IPPROTO_IPV6, IPV6_PKTINFO, info);
  }
  in_pktinfo info{};
  if (is_ipv4(from_)) std::memcpy(&info.ipi_spec_dst, from_.data() + ipv4_offset, 4);
  info.ipi_ifindex = static_cast<int>(interface_);
  write_control(header_, IPPROTO_IP, IP_PKTINFO, info);
}

}  // namespace slamgw::mqttsn
