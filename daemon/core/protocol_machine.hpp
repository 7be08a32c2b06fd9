// SPDX-License-Identifier: Apache-2.0
// The contract of every protocol machine: inputs `on_<what happened>(..., now)` change it and leave
// actions; a shell drains `next_action()` until empty after each input, then re-arms its one timer
// to `deadline()`, and calls `on_deadline(now)` when it passes. No I/O, no clock, no threads, no
// logging inside. `MachineDriver` (daemon/runtime) is the shell's half.
#pragma once

#include <deque>
#include <optional>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw {

/// The action queue of a machine. `Action` is a std::variant of imperative verbs. Bounded by its
/// shell: a shell always drains to empty before the next input, so the queue holds what one input
/// can cause.
template <class Action>
class ActionQueue {
 public:
  void push(Action action) { actions_.push_back(std::move(action)); }

  std::optional<Action> pop() {
    if (actions_.empty()) return std::nullopt;
    std::optional<Action> first(std::move(actions_.front()));
    actions_.pop_front();
    return first;
  }

 private:
  std::deque<Action> actions_;
};

/// The earlier of two optional deadlines.
inline std::optional<TimePoint> earlier(std::optional<TimePoint> a, std::optional<TimePoint> b) {
  if (!a) return b;
  if (!b) return a;
  return *a < *b ? a : b;
}

}  // namespace slamgw
