// SPDX-License-Identifier: Apache-2.0
// The address of a gateway or a broker, and sockets that are connected to it.
#pragma once

#include <sys/socket.h>

#include <cstdint>
#include <string>

namespace slamgw::bench {

struct Address {
  sockaddr_storage storage{};
  socklen_t size = 0;

  std::uint16_t port() const;
};

/// 127.0.0.1.
Address loopback(std::uint16_t port);
/// HOST:PORT or [HOST]:PORT. Blocks while the name is looked up. Throws std::runtime_error.
Address parse_address(const std::string& text, int socket_type);
/// A socket that is connected to `address`; `flags` beside SOCK_CLOEXEC. Throws std::runtime_error.
int open_connected(const Address& address, int socket_type, int flags = 0);
/// Datagrams that the kernel has dropped because the socket on this local port did not read them
/// in time (/proc/net/udp, /proc/net/udp6).
std::uint64_t dropped_datagrams(std::uint16_t port);

}  // namespace slamgw::bench
