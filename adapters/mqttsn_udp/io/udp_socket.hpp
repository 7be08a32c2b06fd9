// SPDX-License-Identifier: Apache-2.0
// UDP sockets that know to which local address each datagram came, and send from a given one; and
// the datagrams that they send.
#pragma once

#include <netinet/in.h>
#include <sys/socket.h>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/udp.hpp>
#include <boost/asio/ip/v6_only.hpp>

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/runtime/loop_turn.hpp"

namespace slamgw::mqttsn {

/// One datagram as sendmsg(2) and sendmmsg(2) want it: the address that it goes to, the local
/// address that it leaves from, and its octets. Points into itself, so it stays where it is filled.
class OutgoingDatagram {
 public:
  OutgoingDatagram() = default;
  OutgoingDatagram(const OutgoingDatagram&) = delete;
  OutgoingDatagram& operator=(const OutgoingDatagram&) = delete;

  /// `is_ipv6_socket`: such a socket takes IPv4 addresses IPv4-mapped. Others can't use IPv6
  /// addresses.
  void fill(bool is_ipv6_socket, const Endpoint& to, const LocalAddress& from, Bytes bytes);
  /// Lets the kernel choose the interface, for another attempt. Returns false if it did already.
  bool forget_interface();
  const msghdr& header() const { return header_; }

 private:
  void write_source();

  bool is_ipv6_socket_ = false;
  bool is_to_ipv4_ = false;
  LocalAddress from_;
  boost::asio::ip::udp::endpoint target_;
  alignas(cmsghdr) std::array<std::uint8_t, CMSG_SPACE(sizeof(in6_pktinfo))> control_{};
  Bytes bytes_;
  iovec part_{};
  msghdr header_{};
};

/// One UDP socket of `mqttsn.listen`: reports the local address that each datagram came to, and
/// sends from a given local address (R17). I/O shell; knows nothing of MQTT-SN. Loop's thread only.
/// Owned by shared_ptr: a wait that is under way keeps it alive.
class UdpSocket : public std::enable_shared_from_this<UdpSocket> {
 public:
  /// `is_truncated`: the datagram was longer than the buffer; `bytes` is its beginning.
  struct Datagram {
    Endpoint from;  ///< without a scope where the socket has one interface only
    LocalAddress to;
    ByteView bytes;
    bool is_truncated = false;
  };
  using Receive = std::function<void(const Datagram&)>;

  /// Binds at once. `listen` is `ADDRESS:PORT` or `[ADDRESS]:PORT`; `[::]` takes IPv4 too; port 0
  /// is any. `interface` may be empty. `kept` is a socket that an earlier process has made from the
  /// same values, or -1. It is closed if its interface has gone since. Throws std::runtime_error
  /// with a sentence for operators, which begins with the configuration's `key`.
  UdpSocket(boost::asio::io_context& io, const std::string& listen, const std::string& interface,
            int kept = -1, const char* key = "mqttsn.listen");
  ~UdpSocket();

  /// Calls `receive` for each datagram from now on, a bounded number in each turn of the loop.
  /// `receive` may call `send`. `number` becomes LocalAddress::socket of each datagram.
  void start(Receive receive, std::uint8_t number = 0);
  /// Receives nothing more; `send` still works.
  void stop_receiving();
  void close();

  /// Never blocks. Returns false if the kernel does not take the datagram, which is then lost.
  bool send(const Endpoint& to, const LocalAddress& from, Bytes bytes);
  /// Sends at the end of the present turn (LoopTurn), together with others by one call to the
  /// kernel. can_reach(to.address) must hold. If the interface does not take it, the kernel chooses
  /// one.
  void send_soon(const Endpoint& to, const LocalAddress& from, Bytes bytes);
  /// Sends now what send_soon() has put off.
  void flush();
  /// Joins `group` on this interface. Returns true also when it was joined before.
  bool join(const boost::asio::ip::address& group, std::uint32_t interface);
  void leave(const boost::asio::ip::address& group, std::uint32_t interface);

  std::uint16_t port() const { return port_; }
  int descriptor() { return socket_.native_handle(); }
  bool is_taken_over() const { return is_taken_over_; }
  /// Checks the family of the address; a socket on `[::]` reaches IPv4, too.
  bool can_reach(const IpAddress& to) const {
    return is_ipv4(to) ? !is_ipv6_ || takes_ipv4_too_ : is_ipv6_;
  }
  struct Counts {
    std::uint64_t kernel_drops = 0;  ///< datagrams that the kernel dropped: we were too slow
    std::uint64_t truncated = 0;     ///< datagrams that were longer than the buffer
    std::uint64_t sends_failed = 0;  ///< datagrams of send_soon() that could not be sent
    Counts& operator+=(const Counts& other);
  };
  const Counts& counts() const { return counts_; }

 private:
  struct Incoming;
  struct Outgoing;

  void open(const boost::asio::ip::udp::endpoint& endpoint, const std::string& interface, int kept);
  void set_options();
  void bind_to(const std::string& interface);
  void wait();
  void receive_batches();
  bool receive_batch();
  void send_again(OutgoingDatagram& datagram);
  bool transmit(const OutgoingDatagram& datagram);
  bool change_membership(int option, const boost::asio::ip::address& group,
                         std::uint32_t interface);

  LoopTurn& turn_;
  boost::asio::ip::udp::socket socket_;
  bool is_ipv6_ = false;
  bool takes_ipv4_too_ = false;
  bool is_bound_to_interface_ = false;
  bool is_taken_over_ = false;
  std::uint16_t port_ = 0;
  std::uint8_t number_ = 0;
  Counts counts_;
  std::unique_ptr<Incoming> incoming_;
  std::unique_ptr<Outgoing> outgoing_;
  Receive receive_;  ///< empty: nothing is received
};

/// `address` is the beginning of a sockaddr_in or a sockaddr_in6.
Endpoint from_sockaddr(const sockaddr& address);
Endpoint from_asio(const boost::asio::ip::udp::endpoint& endpoint);

}  // namespace slamgw::mqttsn
