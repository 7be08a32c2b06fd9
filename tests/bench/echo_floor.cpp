// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/echo_floor.hpp"

#include <pthread.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <ctime>
#include <stdexcept>

#include "simulation/thread/packet.hpp"

namespace slamgw::bench {

EchoFloor::EchoFloor() : descriptor_(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
  const Address any = loopback(0);
  if (bind(descriptor_, reinterpret_cast<const sockaddr*>(&any.storage), any.size) != 0)
    throw std::runtime_error("no socket for the floor of pings");
  thread_ = std::thread([this] { answer(); });
}

EchoFloor::~EchoFloor() {
  shutdown(descriptor_, SHUT_RDWR);  // recvfrom() returns 0, also on a socket without a peer
  thread_.join();
  close(descriptor_);
}

Address EchoFloor::address() const {
  Address own;
  own.size = sizeof own.storage;
  getsockname(descriptor_, reinterpret_cast<sockaddr*>(&own.storage), &own.size);
  return own;
}

double EchoFloor::cpu_s() {
  clockid_t clock{};
  timespec used{};
  if (pthread_getcpuclockid(thread_.native_handle(), &clock) != 0) return 0;
  clock_gettime(clock, &used);
  return static_cast<double>(used.tv_sec) + static_cast<double>(used.tv_nsec) / 1e9;
}

void EchoFloor::answer() const {
  const std::array<std::uint8_t, 2> pong{2, static_cast<std::uint8_t>(sim::sn::Type::pingresp)};
  std::array<std::uint8_t, 256> buffer;
  for (;;) {
    sockaddr_storage from{};
    socklen_t size = sizeof from;
    const auto got = recvfrom(descriptor_, buffer.data(), buffer.size(), 0,
                              reinterpret_cast<sockaddr*>(&from), &size);
    if (got <= 0) return;
    (void)sendto(descriptor_, pong.data(), pong.size(), MSG_NOSIGNAL,
                 reinterpret_cast<const sockaddr*>(&from), size);
  }
}

}  // namespace slamgw::bench
