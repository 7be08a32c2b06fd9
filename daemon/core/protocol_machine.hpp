// SPDX-License-Identifier: Apache-2.0
// The contract of every protocol machine, as the compiler checks it. Inputs `on_<what
// happened>(..., now)` change a machine and leave actions. After each input a shell drains
// `next_action()` until empty, then re-arms its one timer to `deadline()`. When the timer expires,
// perhaps a little early, the shell calls `on_deadline(now)`. No I/O, no clock, no threads, no
// logging inside. `MachineDriver` (daemon/runtime) is the shell's half.
#pragma once

#include <concepts>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "daemon/core/time.hpp"

namespace slamgw {

template <class T>
inline constexpr bool is_optional_variant = false;
template <class... Actions>
inline constexpr bool is_optional_variant<std::optional<std::variant<Actions...>>> = true;

template <class Machine>
concept ProtocolMachine = requires(Machine& machine, const Machine& unchanged, const Now& now) {
  requires is_optional_variant<decltype(machine.next_action())>;
  { unchanged.deadline() } -> std::same_as<std::optional<TimePoint>>;
  { machine.on_deadline(now) } -> std::same_as<void>;
};

/// The std::variant of imperative verbs that the machine leaves.
template <ProtocolMachine Machine>
using ActionOf = typename decltype(std::declval<Machine&>().next_action())::value_type;

/// The action queue of a machine. Bounded by its shell: a shell drains to empty before it takes the
/// next input from outside, so the queue holds what one input can cause. Keeps its memory, so that
/// nothing is allocated for the next input.
template <class Action>
class ActionQueue {
 public:
  /// Makes the action in place: g++ 12 warns of every variant that is made and then moved.
  template <class Verb>
  void push(Verb&& verb) {
    actions_.emplace_back(std::forward<Verb>(verb));
  }

  std::optional<Action> pop() {
    if (first_ == actions_.size()) return std::nullopt;
    std::optional<Action> action(std::move(actions_[first_++]));
    if (first_ == actions_.size()) clear();
    return action;
  }

 private:
  static constexpr std::size_t kept_capacity = 256;

  void clear() {
    actions_.clear();
    first_ = 0;
    if (actions_.capacity() > kept_capacity) std::vector<Action>().swap(actions_);
  }

  std::vector<Action> actions_;
  std::size_t first_ = 0;  ///< index of the next action to take
};

/// The earlier of two optional deadlines.
inline std::optional<TimePoint> earlier(std::optional<TimePoint> a, std::optional<TimePoint> b) {
  if (!a) return b;
  if (!b) return a;
  return *a < *b ? a : b;
}

}  // namespace slamgw
