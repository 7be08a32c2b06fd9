// SPDX-License-Identifier: Apache-2.0
// The shell's half of the contract of a protocol machine: one input, drain the actions, re-arm the
// one timer. Used by every I/O shell; runs on the loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <optional>
#include <type_traits>
#include <utility>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/time.hpp"
#include "daemon/runtime/drain_queue.hpp"

namespace slamgw {

inline Now read_clocks() {
  return {std::chrono::steady_clock::now(), std::chrono::system_clock::now()};
}

template <ProtocolMachine Machine>
class MachineDriver final : private DrainQueue::Member {
 public:
  using Action = ActionOf<Machine>;

  /// `perform` does one action; it may lead back to `input()` of this machine or of another: the
  /// outermost call drains them all. `on_drained` is called when no action is left.
  MachineDriver(boost::asio::io_context& io, Machine& machine, std::function<void(Action&)> perform,
                std::function<void()> on_drained = {})
      : machine_(machine),
        perform_(std::move(perform)),
        on_drained_(std::move(on_drained)),
        queue_(boost::asio::use_service<DrainQueue>(io)),
        timer_(io) {}
  ~MachineDriver() { queue_.remove(*this); }
  MachineDriver(const MachineDriver&) = delete;
  MachineDriver& operator=(const MachineDriver&) = delete;

  const Machine& machine() const { return machine_; }

  /// Calls an input of the machine, `input(&Outbox::on_published, sequence)`, or a function with
  /// the machine before the arguments, then performs what came of it. Either gets `now` behind the
  /// arguments where it takes it. Inside an input of another machine, which asks this one, that is
  /// performed when the other input is over.
  template <class Input, class... Arguments>
  void input(Input&& input, Arguments&&... arguments) {
    queue_.add(*this, [&] {
      if constexpr (std::is_invocable_v<Input, Machine&, Arguments..., const Now&>) {
        std::invoke(input, machine_, std::forward<Arguments>(arguments)..., read_clocks());
      } else {
        std::invoke(input, machine_, std::forward<Arguments>(arguments)...);
      }
    });
  }

  /// No deadline fires any more.
  void stop() {
    armed_.reset();
    is_stopped_ = true;
    timer_.cancel();
  }

 private:
  void drain() override {
    while (auto action = machine_.next_action()) perform_(*action);
    if (on_drained_) on_drained_();
    arm();
  }

  /// A deadline that moves away, as with each message, leaves the timer as it is: a check too early
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
    if (!due || *due > read_clocks().mono) return arm();
    input([](Machine& machine, const Now& now) { machine.on_deadline(now); });
  }

  Machine& machine_;
  std::function<void(Action&)> perform_;
  std::function<void()> on_drained_;
  DrainQueue& queue_;
  boost::asio::steady_timer timer_;
  std::optional<TimePoint> armed_;
  bool is_stopped_ = false;
};

}  // namespace slamgw
