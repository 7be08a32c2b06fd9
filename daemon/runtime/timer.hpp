// SPDX-License-Identifier: Apache-2.0
// Calls a function later, on the one thread of its io_context or thread pool. At most one call is
// awaited at a time: another one takes its place. After cancel(), and after the end of this object,
// no call comes, although a handler of Asio that is queued already still runs. Used by every I/O
// shell.
#pragma once

#include <boost/asio/steady_timer.hpp>
#include <cstdint>
#include <functional>
#include <memory>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw {

class Timer {
 public:
  /// `where`: an execution context of one thread, or its executor.
  explicit Timer(auto&& where) : timer_(where) {}
  Timer(const Timer&) = delete;
  Timer& operator=(const Timer&) = delete;

  /// Calls `then` at `due`.
  template <class Then>
  void at(TimePoint due, Then then) {
    timer_.expires_at(due);
    timer_.async_wait([round = ++*round_, current = std::weak_ptr(round_),
                       then = std::move(then)](boost::system::error_code) mutable {
      if (const auto now = current.lock(); now && *now == round) then();
    });
  }
  template <class Then>
  void after(Duration delay, Then then) {
    at(std::chrono::steady_clock::now() + delay, std::move(then));
  }
  /// Calls `each` after `interval`, and again and again. `each` may cancel the timer or end it.
  void every(Duration interval, std::function<void()> each) {
    after(interval, [this, interval, each = std::move(each)]() mutable {
      every(interval, each);
      each();
    });
  }
  void cancel() {
    ++*round_;
    timer_.cancel();
  }

 private:
  boost::asio::steady_timer timer_;
  std::shared_ptr<std::uint64_t> round_ = std::make_shared<std::uint64_t>(0);
};

}  // namespace slamgw
