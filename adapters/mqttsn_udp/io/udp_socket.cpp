// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/udp_socket.hpp"

#include <fmt/format.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "daemon/core/parse_number.hpp"
#include "daemon/core/spare_buffers.hpp"

namespace slamgw::mqttsn {

namespace {

namespace asio = boost::asio;
using asio::ip::udp;

constexpr std::size_t ipv4_offset = 12;  // in an IPv4-mapped address

udp::endpoint to_asio(const Endpoint& to, bool is_ipv6_socket) {
  if (is_ipv6_socket)
    return {asio::ip::address_v6(to.address, is_ipv4(to.address) ? 0 : to.scope_id), to.port};
  asio::ip::address_v4::bytes_type ipv4;
  std::copy_n(to.address.begin() + ipv4_offset, ipv4.size(), ipv4.begin());
  return {asio::ip::address_v4(ipv4), to.port};
}

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

void OutgoingDatagram::fill(bool is_ipv6_socket, const Endpoint& to, const LocalAddress& from,
                            Bytes bytes) {
  is_ipv6_socket_ = is_ipv6_socket;
  is_to_ipv4_ = is_ipv4(to.address);
  from_ = from;
  SpareBuffers<Bytes>::give_back(std::exchange(bytes_, std::move(bytes)));
  part_ = {bytes_.data(), bytes_.size()};
  header_ = {};
  header_.msg_iov = &part_;
  header_.msg_iovlen = 1;
  target_ = to_asio(to, is_ipv6_socket);
  header_.msg_name = target_.data();
  header_.msg_namelen = static_cast<socklen_t>(target_.size());
  write_source();
}

bool OutgoingDatagram::forget_interface() {
  if (std::exchange(from_.interface, 0) == 0) return false;
  write_source();
  return true;
}

void OutgoingDatagram::write_source() {
  const IpAddress& source = from_.address;
  if (source == IpAddress{} && from_.interface == 0) {
    header_.msg_control = nullptr;
    header_.msg_controllen = 0;
    return;
  }
  header_.msg_control = control_.data();
  header_.msg_controllen = control_.size();
  if (is_ipv6_socket_) {
    in6_pktinfo info{};
    std::memcpy(&info.ipi6_addr, source.data(), source.size());
    if (is_to_ipv4_ && source == IpAddress{}) {  // "any source" must be an IPv4 address then
      info.ipi6_addr.s6_addr[10] = info.ipi6_addr.s6_addr[11] = 0xff;
    }
    info.ipi6_ifindex = from_.interface;
    return write_control(header_, IPPROTO_IPV6, IPV6_PKTINFO, info);
  }
  in_pktinfo info{};
  if (is_ipv4(source)) std::memcpy(&info.ipi_spec_dst, source.data() + ipv4_offset, 4);
  info.ipi_ifindex = static_cast<int>(from_.interface);
  write_control(header_, IPPROTO_IP, IP_PKTINFO, info);
}

namespace {

/// Larger than any MQTT-SN message on a mesh, so that longer ones are noticed (R9).
constexpr std::size_t buffer_octets = 2048;
/// The kernel's default holds some 277 small datagrams; the kernel may grant less than this.
constexpr int receive_buffer_octets = 4 * 1024 * 1024;
/// A flood must not keep the loop from everything else.
constexpr int max_batches_per_wake_up = 4;
/// Radius 0, "the whole network" (R18).
constexpr int multicast_hops = 16;
constexpr std::size_t control_octets = 256;
/// The port where Nordic's clients expect their gateway (R22). Border routers made for them use it.
constexpr unsigned nordic_port = 47193;

/// Parses an address that the configuration has checked.
udp::endpoint parse_listen(const std::string& listen) {
  const std::size_t colon = listen.rfind(':');
  std::string address = listen.substr(0, colon);
  if (address.starts_with('[') && address.ends_with(']'))
    address = address.substr(1, address.size() - 2);
  const auto port = parse_number<std::uint16_t>(std::string_view(listen).substr(colon + 1));
  return {asio::ip::make_address(address), port.value()};
}

void set_flag(int descriptor, int level, int option, int value) {
  setsockopt(descriptor, level, option, &value, sizeof value);
}

/// Returns the interface that a socket is bound to. Returns nothing when that is gone, even if
/// another interface has its name now.
std::optional<std::string> bound_interface(int descriptor) {
  char name[IFNAMSIZ] = {};
  socklen_t size = sizeof name;
  if (getsockopt(descriptor, SOL_SOCKET, SO_BINDTODEVICE, name, &size) != 0) return std::nullopt;
  return std::string(name);
}

IpAddress mapped(const in_addr& address) {
  IpAddress out{};
  out[10] = out[11] = 0xff;
  std::memcpy(out.data() + 12, &address, 4);
  return out;
}

/// The address that a datagram came to, from its control messages.
void read_control(msghdr& header, LocalAddress& to, std::uint64_t& kernel_drops) {
  for (cmsghdr* c = CMSG_FIRSTHDR(&header); c; c = CMSG_NXTHDR(&header, c)) {
    if (c->cmsg_level == IPPROTO_IPV6 && c->cmsg_type == IPV6_PKTINFO) {
      in6_pktinfo info{};
      std::memcpy(&info, CMSG_DATA(c), sizeof info);
      std::memcpy(to.address.data(), &info.ipi6_addr, 16);
      to.interface = info.ipi6_ifindex;
    } else if (c->cmsg_level == IPPROTO_IP && c->cmsg_type == IP_PKTINFO) {
      in_pktinfo info{};
      std::memcpy(&info, CMSG_DATA(c), sizeof info);
      to.address = mapped(info.ipi_addr);
      if (!is_multicast(to.address)) to.address = mapped(info.ipi_spec_dst);  // of a broadcast
      to.interface = static_cast<std::uint32_t>(info.ipi_ifindex);
    } else if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SO_RXQ_OVFL) {
      std::uint32_t drops = 0;
      std::memcpy(&drops, CMSG_DATA(c), sizeof drops);
      kernel_drops = drops;
    }
  }
}

/// Returns advice about this error, if there is any.
std::string advise(const boost::system::error_code& error, unsigned port) {
  if (error == asio::error::address_in_use) {
    const std::string_view whose =
        port == nordic_port ? " (on Nordic's border routers it is Paho's gateway: sudo systemctl "
                              "disable --now paho-mqttsn-gateway)"
                            : "";
    return fmt::format(
        "; another MQTT-SN gateway has the port{}; sudo ss -ulpn 'sport = :{}' shows which", whose,
        port);
  }
  if (error == asio::error::no_permission || error == asio::error::access_denied)
    return "; only root may use ports below 1024: choose another";
  if (error.value() == EADDRNOTAVAIL) return "; no interface of this host has this address";
  return {};
}

}  // namespace

/// The datagrams that one call to the kernel brings: at full rate they come in dozens.
struct UdpSocket::Incoming {
  static constexpr int size = 16;

  sockaddr_storage from[size];
  std::uint8_t bytes[size][buffer_octets];
  alignas(cmsghdr) std::uint8_t control[size][control_octets];
  iovec parts[size];
  mmsghdr headers[size];

  Incoming() {
    for (int i = 0; i < size; ++i) {
      parts[i] = {bytes[i], buffer_octets};
      headers[i] = {};
      msghdr& header = headers[i].msg_hdr;
      header.msg_name = &from[i];
      header.msg_iov = &parts[i];
      header.msg_iovlen = 1;
      header.msg_control = control[i];
    }
    renew(size);
  }
  /// Resets the first `count` headers, into which the kernel has written. The others stay out of
  /// the processor's cache: one datagram at a time is usual.
  void renew(int count) {
    for (int i = 0; i < count; ++i) {
      msghdr& header = headers[i].msg_hdr;
      header.msg_namelen = sizeof from[i];
      header.msg_controllen = control_octets;
    }
  }
};

/// The datagrams that one call to the kernel takes.
struct UdpSocket::Outgoing {
  static constexpr unsigned size = 64;

  unsigned count = 0;
  std::array<OutgoingDatagram, size> datagrams;
  std::array<mmsghdr, size> headers;
};

UdpSocket::Counts& UdpSocket::Counts::operator+=(const Counts& other) {
  kernel_drops += other.kernel_drops;
  truncated += other.truncated;
  sends_failed += other.sends_failed;
  return *this;
}

UdpSocket::~UdpSocket() { flush(); }

UdpSocket::UdpSocket(asio::io_context& io, const std::string& listen, const std::string& interface,
                     int kept, const char* key)
    : turn_(LoopTurn::of(io)),
      socket_(io),
      is_bound_to_interface_(!interface.empty()),
      incoming_(std::make_unique<Incoming>()),
      outgoing_(std::make_unique<Outgoing>()) {
  udp::endpoint endpoint;
  try {
    endpoint = parse_listen(listen);
    open(endpoint, interface, kept);
  } catch (const boost::system::system_error& error) {
    throw std::runtime_error(fmt::format("{}: can't use {}: {}{}", key, listen,
                                         error.code().message(),
                                         advise(error.code(), endpoint.port())));
  }
}

void UdpSocket::open(const udp::endpoint& endpoint, const std::string& interface, int kept) {
  is_ipv6_ = endpoint.address().is_v6();
  takes_ipv4_too_ = is_ipv6_ && endpoint.address().is_unspecified();
  is_taken_over_ = kept >= 0 && bound_interface(kept) == interface;
  if (kept >= 0 && !is_taken_over_) ::close(kept);
  // After assign(), Asio itself removes the descriptor from epoll, where a duplicate would stay.
  const int descriptor =
      is_taken_over_ ? kept : ::socket(endpoint.protocol().family(), SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (descriptor < 0) throw boost::system::system_error(errno, boost::system::system_category());
  socket_.assign(endpoint.protocol(), descriptor);
  set_options();
  if (!is_taken_over_) {
    if (is_ipv6_) socket_.set_option(asio::ip::v6_only(!takes_ipv4_too_));
    if (is_bound_to_interface_) bind_to(interface);
    socket_.bind(endpoint);
  }
  socket_.non_blocking(true);
  port_ = socket_.local_endpoint().port();
}

void UdpSocket::set_options() {
  const int descriptor = socket_.native_handle();
  set_flag(descriptor, SOL_SOCKET, SO_RCVBUF, receive_buffer_octets);
  set_flag(descriptor, SOL_SOCKET, SO_RXQ_OVFL, 1);
  if (is_ipv6_) {
    set_flag(descriptor, IPPROTO_IPV6, IPV6_RECVPKTINFO, 1);
    set_flag(descriptor, IPPROTO_IPV6, IPV6_MULTICAST_HOPS, multicast_hops);
    set_flag(descriptor, IPPROTO_IPV6, IPV6_MULTICAST_LOOP, 1);
  }
  if (is_ipv6_ && !takes_ipv4_too_) return;
  // Of a datagram to a network's broadcast address, IPV6_PKTINFO does not name our own address.
  set_flag(descriptor, IPPROTO_IP, IP_PKTINFO, 1);
  set_flag(descriptor, IPPROTO_IP, IP_MULTICAST_TTL, multicast_hops);
}

void UdpSocket::bind_to(const std::string& interface) {
  if (setsockopt(socket_.native_handle(), SOL_SOCKET, SO_BINDTODEVICE, interface.data(),
                 static_cast<socklen_t>(interface.size())) != 0) {
    throw std::runtime_error(
        fmt::format("mqttsn.interface: can't bind to '{}': {}", interface, std::strerror(errno)));
  }
}

void UdpSocket::start(Receive receive, std::uint8_t number) {
  number_ = number;
  receive_ = std::move(receive);
  wait();
}

void UdpSocket::stop_receiving() { receive_ = nullptr; }

void UdpSocket::close() {
  flush();
  boost::system::error_code ignored;
  socket_.close(ignored);
}

void UdpSocket::wait() {
  socket_.async_wait(udp::socket::wait_read,
                     [this, alive = shared_from_this()](boost::system::error_code error) {
                       if (error || !socket_.is_open() || !receive_) return;
                       turn_.run([this] { receive_batches(); });
                       if (socket_.is_open() && receive_) wait();
                     });
}

void UdpSocket::receive_batches() {
  for (int i = 0; i < max_batches_per_wake_up && receive_batch(); ++i) {
  }
}

/// Returns false when nothing more is waiting. Errors of earlier sends (a port unreachable) appear
/// here, too, and mean nothing for a server.
bool UdpSocket::receive_batch() {
  if (!socket_.is_open() || !receive_) return false;
  mmsghdr* const headers = incoming_->headers;
  const int count =
      recvmmsg(socket_.native_handle(), headers, Incoming::size, MSG_DONTWAIT, nullptr);
  if (count < 0) return errno != EAGAIN && errno != EWOULDBLOCK;
  for (int i = 0; i < count && receive_; ++i) {
    Datagram datagram;
    datagram.from = from_sockaddr(reinterpret_cast<const sockaddr&>(incoming_->from[i]));
    datagram.bytes = ByteView(incoming_->bytes[i], headers[i].msg_len);
    datagram.is_truncated = (headers[i].msg_hdr.msg_flags & MSG_TRUNC) != 0;
    datagram.to.socket = number_;
    read_control(headers[i].msg_hdr, datagram.to, counts_.kernel_drops);
    if (is_bound_to_interface_) datagram.from.scope_id = 0;  // it changes with the interface
    if (datagram.is_truncated) ++counts_.truncated;
    receive_(datagram);
  }
  incoming_->renew(count);
  return count == Incoming::size;
}

bool UdpSocket::send(const Endpoint& to, const LocalAddress& from, Bytes bytes) {
  if (!socket_.is_open() || !can_reach(to.address)) return false;
  OutgoingDatagram datagram;
  datagram.fill(is_ipv6_, to, from, std::move(bytes));
  return transmit(datagram);
}

void UdpSocket::send_soon(const Endpoint& to, const LocalAddress& from, Bytes bytes) {
  outgoing_->datagrams[outgoing_->count++].fill(is_ipv6_, to, from, std::move(bytes));
  if (outgoing_->count == Outgoing::size) return flush();
  if (outgoing_->count > 1) return;
  turn_.at_end([socket = weak_from_this()] {
    if (const auto alive = socket.lock()) alive->flush();
  });
}

/// A datagram that cannot be sent ends the call before it; the others are sent all the same.
void UdpSocket::flush() {
  const unsigned count = std::exchange(outgoing_->count, 0);
  for (unsigned i = 0; i < count; ++i)
    outgoing_->headers[i] = {outgoing_->datagrams[i].header(), 0};
  for (unsigned sent = 0; sent < count;) {
    const int taken = sendmmsg(socket_.native_handle(), &outgoing_->headers[sent], count - sent,
                               MSG_DONTWAIT | MSG_NOSIGNAL);
    if (taken > 0) {
      sent += static_cast<unsigned>(taken);
    } else {
      send_again(outgoing_->datagrams[sent++]);
    }
  }
}

/// The interface may have been made again under another index; its address is the same.
void UdpSocket::send_again(OutgoingDatagram& datagram) {
  if (!datagram.forget_interface() || !transmit(datagram)) ++counts_.sends_failed;
}

bool UdpSocket::transmit(const OutgoingDatagram& datagram) {
  return sendmsg(socket_.native_handle(), &datagram.header(), MSG_DONTWAIT | MSG_NOSIGNAL) >= 0;
}

bool UdpSocket::join(const asio::ip::address& group, std::uint32_t interface) {
  return change_membership(MCAST_JOIN_GROUP, group, interface) || errno == EADDRINUSE;
}

void UdpSocket::leave(const asio::ip::address& group, std::uint32_t interface) {
  change_membership(MCAST_LEAVE_GROUP, group, interface);
}

bool UdpSocket::change_membership(int option, const asio::ip::address& group,
                                  std::uint32_t interface) {
  const udp::endpoint endpoint(group, 0);
  if (!can_reach(from_asio(endpoint).address)) return false;
  group_req request{};
  request.gr_interface = interface;
  std::memcpy(&request.gr_group, endpoint.data(), endpoint.size());
  return setsockopt(socket_.native_handle(), group.is_v6() ? IPPROTO_IPV6 : IPPROTO_IP, option,
                    &request, sizeof request) == 0;
}

Endpoint from_sockaddr(const sockaddr& address) {
  Endpoint out;
  if (address.sa_family == AF_INET) {
    sockaddr_in v4{};
    std::memcpy(&v4, &address, sizeof v4);
    out.address = mapped(v4.sin_addr);
    out.port = ntohs(v4.sin_port);
  } else {
    sockaddr_in6 v6{};
    std::memcpy(&v6, &address, sizeof v6);
    std::memcpy(out.address.data(), &v6.sin6_addr, out.address.size());
    out.port = ntohs(v6.sin6_port);
    out.scope_id = v6.sin6_scope_id;
  }
  return out;
}

Endpoint from_asio(const udp::endpoint& endpoint) { return from_sockaddr(*endpoint.data()); }

}  // namespace slamgw::mqttsn
