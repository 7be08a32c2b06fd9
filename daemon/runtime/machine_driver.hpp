// SPDX-License-Identifier: Apache-2.0
// The shell's half of the contract of a protocol machine: one input, drain the actions, re-arm the
// one timer. Used by every I/O shell; runs on the loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <optional>
#include <type_traits>
#include <utility>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/time.hpp"
#include "daemon/runtime/drain_queue.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

inline Now read_clocks() {
  return {std::chrono::steady_clock::now(), std::chrono::system_clock::now()};
}

template <ProtocolMachine Machine>
class MachineDriver final : private DrainQueue::Member {
 public:
  using Action = ActionOf<Machine>;

  /// One input of the machine: lives until the end of the full expression that made it, and then
  /// has the machine's actions performed.
  class Input {
   public:
    explicit Input(MachineDriver& driver) : driver_(driver), is_outermost_(driver.queue_.begin()) {}
    ~Input() noexcept(false) { driver_.queue_.end(driver_, is_outermost_); }
    Input(const Input&) = delete;
    Input& operator=(const Input&) = delete;
    Machine* operator->() { return &driver_.machine_; }

   private:
    MachineDriver& driver_;
    const bool is_outermost_;
  };

  /// `perform` carries out one action. It may call an input of this machine or of another; the
  /// outermost input drains them all. `on_drained` is called when no action is left.
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

  /// Calls an input, `driver->on_published(sequence, read_clocks())`, then performs the actions
  /// that it leaves. Inside an input of another machine, they wait until that input ends.
  Input operator->() { return Input(*this); }
  /// Performs the actions that were left outside an input.
  void perform_actions() { Input(*this); }

  /// Stops the timer: no deadline fires any more.
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

  /// Sets the timer to the machine's deadline. A timer that is earlier is left as it is: an early
  /// check costs less than setting the timer again at each message.
  void arm() {
    const std::optional<TimePoint> next = machine_.deadline();
    if (is_stopped_ || !next || (armed_ && *armed_ <= *next)) return;
    armed_ = next;
    timer_.at(*next, [this] { on_time(); });
  }

  void on_time() {
    armed_.reset();
    const std::optional<TimePoint> due = machine_.deadline();
    if (!due || *due > read_clocks().mono) return arm();
    Input(*this)->on_deadline(read_clocks());
  }

  Machine& machine_;
  std::function<void(Action&)> perform_;
  std::function<void()> on_drained_;
  DrainQueue& queue_;
  Timer timer_;
  std::optional<TimePoint> armed_;
  bool is_stopped_ = false;
};

}  // namespace slamgw
