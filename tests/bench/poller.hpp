// SPDX-License-Identifier: Apache-2.0
// epoll with one number for each descriptor and waits of a few microseconds: the load generator's
// own cost must stay small beside what it measures.
#pragma once

#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <stdexcept>

#include "tests/bench/message.hpp"

namespace slamgw::bench {

class Poller {
 public:
  Poller() : descriptor_(epoll_create1(EPOLL_CLOEXEC)) {
    if (descriptor_ < 0) throw std::runtime_error("epoll_create1 failed");
  }
  ~Poller() { close(descriptor_); }
  Poller(const Poller&) = delete;
  Poller& operator=(const Poller&) = delete;

  /// Watches `descriptor` for reading; a closed descriptor is removed automatically.
  void add(int descriptor, std::uint64_t token) {
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.u64 = token;
    if (epoll_ctl(descriptor_, EPOLL_CTL_ADD, descriptor, &event) != 0)
      throw std::runtime_error("epoll_ctl failed");
  }

  /// Calls `handle(token)` for each readable descriptor; when none is, waits until `end` at most.
  template <class Handle>
  void wait(Clock::time_point end, Handle&& handle) {
    const std::int64_t left = std::max<std::int64_t>(0, to_ns(end) - to_ns(Clock::now()));
    const timespec timeout{left / 1'000'000'000, left % 1'000'000'000};
    const int count = epoll_pwait2(descriptor_, events_.data(), static_cast<int>(events_.size()),
                                   &timeout, nullptr);
    for (int i = 0; i < count; ++i) handle(events_[static_cast<std::size_t>(i)].data.u64);
  }

 private:
  int descriptor_;
  std::array<epoll_event, 256> events_{};
};

}  // namespace slamgw::bench
