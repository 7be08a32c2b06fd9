// SPDX-License-Identifier: Apache-2.0
#include "daemon/runtime/interface_watch.hpp"

#include <linux/netlink.h>
#include <linux/rtnetlink.h>
#include <sys/socket.h>

#include <array>
#include <utility>

#include "daemon/runtime/owned_file.hpp"

namespace slamgw {

using boost::asio::posix::stream_descriptor;

InterfaceWatch::InterfaceWatch(boost::asio::io_context& io) : socket_(io) {}

bool InterfaceWatch::start(std::function<void()> on_change) {
  OwnedFile made(socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC | SOCK_NONBLOCK, NETLINK_ROUTE));
  sockaddr_nl address{};
  address.nl_family = AF_NETLINK;
  address.nl_groups = RTMGRP_LINK | RTMGRP_IPV4_IFADDR | RTMGRP_IPV6_IFADDR;
  if (bind(made.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return false;
  socket_.assign(made.release());
  on_change_ = std::move(on_change);
  wait();
  return true;
}

void InterfaceWatch::stop() {
  boost::system::error_code ignored;
  socket_.close(ignored);
}

void InterfaceWatch::wait() {
  socket_.async_wait(stream_descriptor::wait_read,
                     [this, alive = shared_from_this()](boost::system::error_code error) {
                       if (error || !socket_.is_open()) return;
                       drain();
                       on_change_();
                       if (socket_.is_open()) wait();
                     });
}

/// Discards the messages: their contents do not matter, nor that the kernel may have dropped some
/// (ENOBUFS).
void InterfaceWatch::drain() {
  std::array<char, 8192> ignored{};
  for (int i = 0; i < 64; ++i) {
    if (recv(socket_.native_handle(), ignored.data(), ignored.size(), MSG_DONTWAIT) <= 0) return;
  }
}

}  // namespace slamgw
