// SPDX-License-Identifier: Apache-2.0
#include "tests/support/free_port.hpp"

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ip/udp.hpp>

namespace slamgw::test {

using boost::asio::ip::tcp;
using boost::asio::ip::udp;

std::uint16_t free_tcp_port() {
  boost::asio::io_context io;
  tcp::acceptor acceptor(io, tcp::endpoint(boost::asio::ip::address_v4::loopback(), 0));
  return acceptor.local_endpoint().port();
}

std::uint16_t free_udp_port() {
  boost::asio::io_context io;
  udp::socket socket(io, udp::endpoint(udp::v6(), 0));
  return socket.local_endpoint().port();
}

}  // namespace slamgw::test
