// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho/broker_socket.hpp"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <charconv>
#include <filesystem>
#include <string>

namespace slamgw {
namespace {

/// Of the other end; 0 for what is no TCP connection.
std::uint16_t peer_port(int descriptor) {
  sockaddr_storage peer{};
  socklen_t size = sizeof peer;
  if (getpeername(descriptor, reinterpret_cast<sockaddr*>(&peer), &size) != 0) return 0;
  if (peer.ss_family == AF_INET) return ntohs(reinterpret_cast<sockaddr_in&>(peer).sin_port);
  if (peer.ss_family == AF_INET6) return ntohs(reinterpret_cast<sockaddr_in6&>(peer).sin6_port);
  return 0;
}

}  // namespace

void BrokerSocket::forget() {
  const int descriptor = descriptor_.exchange(-1);
  if (descriptor >= 0) close(descriptor);
}

void BrokerSocket::adopt(std::uint16_t broker_port) {
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
    const std::string name = entry.path().filename();
    int descriptor = -1;
    std::from_chars(name.data(), name.data() + name.size(), descriptor);
    if (peer_port(descriptor) != broker_port) continue;
    const int on = 1;
    setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    descriptor_ = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
    return;
  }
}

void BrokerSocket::discard_on_close() {
  const linger at_once{1, 0};
  if (descriptor_ >= 0) setsockopt(descriptor_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
}

void BrokerSocket::cork(int on) {
  if (descriptor_ >= 0) setsockopt(descriptor_, IPPROTO_TCP, TCP_CORK, &on, sizeof on);
}

}  // namespace slamgw
