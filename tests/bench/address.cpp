// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/address.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace slamgw::bench {
namespace {

std::uint64_t dropped_in(const char* path, std::uint16_t port) {
  std::ifstream file(path);
  const std::string local_port = fmt::format(":{:04X}", port);
  std::uint64_t dropped = 0;
  for (std::string line; std::getline(file, line);) {
    std::istringstream fields(line);
    std::string slot, local, field, last;
    fields >> slot >> local;
    while (fields >> field) last = field;
    if (local.ends_with(local_port)) dropped += std::stoull(last);
  }
  return dropped;
}

}  // namespace

std::uint16_t Address::port() const {
  sockaddr_in address{};  // the port is at the same place in both families
  std::memcpy(&address, &storage, sizeof address);
  return ntohs(address.sin_port);
}

Address loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  Address out{{}, sizeof address};
  std::memcpy(&out.storage, &address, sizeof address);
  return out;
}

Address parse_address(const std::string& text, int socket_type) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos) throw std::runtime_error(text + " is not HOST:PORT");
  std::string host = text.substr(0, colon);
  if (host.starts_with('[') && host.ends_with(']')) host = host.substr(1, host.size() - 2);
  addrinfo hints{};
  hints.ai_socktype = socket_type;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(host.c_str(), text.substr(colon + 1).c_str(), &hints, &found);
  if (error != 0) throw std::runtime_error(text + ": " + gai_strerror(error));
  Address out{{}, found->ai_addrlen};
  std::memcpy(&out.storage, found->ai_addr, found->ai_addrlen);
  freeaddrinfo(found);
  return out;
}

int open_connected(const Address& address, int socket_type, int flags) {
  const int descriptor = socket(address.storage.ss_family, socket_type | SOCK_CLOEXEC | flags, 0);
  if (descriptor < 0) throw std::runtime_error("no socket: too many open files?");
  if (connect(descriptor, reinterpret_cast<const sockaddr*>(&address.storage), address.size) != 0) {
    close(descriptor);
    throw std::runtime_error(fmt::format("no program listens at port {}", address.port()));
  }
  return descriptor;
}

std::uint64_t dropped_datagrams(std::uint16_t port) {
  return dropped_in("/proc/net/udp", port) + dropped_in("/proc/net/udp6", port);
}

}  // namespace slamgw::bench
