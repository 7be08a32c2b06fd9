// SPDX-License-Identifier: Apache-2.0
// The shell's half of the protocol-machine contract: one input, drain the actions, re-arm the one
// timer. Used by every I/O shell; runs on the loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <optional>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw {

inline Now read_clocks() {
  return {std::chrono::steady_clock::now(), std::chrono::system_clock::now()};
}

/// `Machine` has `next_action()`, `deadline()` and `on_deadline(TimePoint)`. `perform` does one
/// action; it may lead back to `input()` (an acknowledgement that fires at once): the outermost
/// call then does the draining.
template <class Machine>
class MachineDriver {
 public:
  using Action = typename decltype(std::declval<Machine&>().next_action())::value_type;

  MachineDriver(boost::asio::io_context& io, Machine& machine, std::function<void(Action&)> perform)
      : machine_(machine), perform_(std::move(perform)), timer_(io) {}

  /// Calls `change(machine, now)`, then performs what came of it.
  template <class Change>
  void input(Change&& change) {
    change(machine_, std::chrono::steady_clock::now());
    if (is_draining_) return;
    is_draining_ = true;
    while (auto action = machine_.next_action()) perform_(*action);
    is_draining_ = false;
    arm();
  }

  void stop() {
    armed_.reset();
    is_stopped_ = true;
    timer_.cancel();
  }

 private:
  /// A deadline that moves away, as with each message, leaves the timer as it is: a look too early
  /// costs less than to set it anew each time.
  void arm() {
    const std::optional<TimePoint> next = machine_.deadline();
    if (is_stopped_ || !next || (armed_ && *armed_ <= *next)) return;
    armed_ = next;
    timer_.expires_at(*next);
    timer_.async_wait([this](boost::system::error_code error) {
      if (!error && !is_stopped_) on_time();
    });
  }

  void on_time() {
    armed_.reset();
    const std::optional<TimePoint> due = machine_.deadline();
    if (!due || *due > std::chrono::steady_clock::now()) return arm();
    input([](Machine& machine, TimePoint now) { machine.on_deadline(now); });
  }

  Machine& machine_;
  std::function<void(Action&)> perform_;
  boost::asio::steady_timer timer_;
  std::optional<TimePoint> armed_;
  bool is_draining_ = false;
  bool is_stopped_ = false;
};

}  // namespace slamgw
