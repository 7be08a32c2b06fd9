// SPDX-License-Identifier: Apache-2.0
// The machines of one loop that have actions left. They are drained one after the other, never one
// inside the other, so that a message passes from machine to machine on a flat stack. One for each
// io_context; MachineDriver finds it there.
#pragma once

#include <algorithm>
#include <boost/asio/execution_context.hpp>
#include <deque>
#include <utility>

namespace slamgw {

class DrainQueue final : public boost::asio::execution_context::service {
 public:
  using key_type = DrainQueue;
  static inline boost::asio::execution_context::id id;

  /// A machine with its shell.
  class Member {
   public:
    /// Performs every action that the machine has left.
    virtual void drain() = 0;

   protected:
    ~Member() = default;
  };

  explicit DrainQueue(boost::asio::execution_context& io) : service(io) {}

  /// Begins a change of a machine. Returns true for the outermost one: changes nest when a change
  /// or a drain calls another machine.
  bool begin() { return !std::exchange(is_busy_, true); }
  /// Ends the change of `member`. The outermost one drains every machine that was changed.
  void end(Member& member, bool is_outermost) {
    if (std::ranges::find(waiting_, &member) == waiting_.end()) waiting_.push_back(&member);
    if (!is_outermost) return;
    while (!waiting_.empty()) {
      Member& next = *waiting_.front();
      waiting_.pop_front();
      next.drain();
    }
    is_busy_ = false;
  }
  /// Removes `member`, which is being destroyed.
  void remove(Member& member) { std::erase(waiting_, &member); }

 private:
  void shutdown() override {}

  std::deque<Member*> waiting_;  // each at most once
  bool is_busy_ = false;
};

}  // namespace slamgw
