// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/journal_socket.hpp"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

namespace slamgw {
namespace {

/// As libsystemd asks for; the kernel gives what net.core.wmem_max allows.
constexpr int send_buffer_bytes = 8 << 20;

}  // namespace

JournalSocket::JournalSocket(std::string path)
    : path_(std::move(path)),
      socket_(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
  if (socket_ >= 0)
    setsockopt(socket_, SOL_SOCKET, SO_SNDBUF, &send_buffer_bytes, sizeof send_buffer_bytes);
}

JournalSocket::~JournalSocket() {
  if (socket_ >= 0) close(socket_);
}

void JournalSocket::send(std::string entry, bool matters) {
  if (flush()) {
    switch (try_send(entry)) {
      case Result::taken: return;
      case Result::never: ++lost_; return;
      case Result::not_now: break;
    }
  }
  if (matters && kept_.size() < max_kept) {
    kept_.push_back(std::move(entry));
  } else {
    ++lost_;
  }
}

bool JournalSocket::flush() {
  while (!kept_.empty()) {
    const Result result = try_send(kept_.front());
    if (result == Result::not_now) return false;
    if (result == Result::never) ++lost_;
    kept_.pop_front();
  }
  return true;
}

std::uint64_t JournalSocket::take_lost() { return std::exchange(lost_, 0); }

/// Not connected: a journal that was started anew is found by its path.
JournalSocket::Result JournalSocket::try_send(const std::string& entry) const {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path_.copy(address.sun_path, sizeof address.sun_path - 1);
  const auto* generic = reinterpret_cast<const sockaddr*>(&address);
  ssize_t sent = -1;
  do {
    sent = sendto(socket_, entry.data(), entry.size(), MSG_NOSIGNAL, generic, sizeof address);
  } while (sent < 0 && errno == EINTR);
  if (sent >= 0) return Result::taken;
  return errno == EMSGSIZE ? Result::never : Result::not_now;
}

}  // namespace slamgw
