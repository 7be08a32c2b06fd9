// SPDX-License-Identifier: Apache-2.0
// The compiler accepts only classes that keep the contract of a protocol machine.
#include "daemon/core/protocol_machine.hpp"

#include <gtest/gtest.h>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

struct Act {};
using Actions = std::variant<Act>;

struct Machine {
  std::optional<Actions> next_action() { return std::nullopt; }
  std::optional<TimePoint> deadline() const { return std::nullopt; }
  void on_deadline(TimePoint) {}
};
static_assert(ProtocolMachine<Machine>);
static_assert(std::same_as<ActionOf<Machine>, Actions>);
static_assert(ProtocolMachine<Gateway>);

struct WithoutDeadline {
  std::optional<Actions> next_action();
  void on_deadline(TimePoint);
};
static_assert(!ProtocolMachine<WithoutDeadline>);

struct WithDeadlineThatChangesIt : Machine {
  std::optional<TimePoint> deadline();
};
static_assert(!ProtocolMachine<WithDeadlineThatChangesIt>);

struct WithBareAction : Machine {
  std::optional<Act> next_action();
};
static_assert(!ProtocolMachine<WithBareAction>);

TEST(ActionQueue, GivesActionsInTheirOrder) {
  ActionQueue<int> queue;
  for (const int action : {1, 2, 3}) queue.push(action);
  EXPECT_EQ(queue.pop(), 1);
  queue.push(4);
  EXPECT_EQ(queue.pop(), 2);
  EXPECT_EQ(queue.pop(), 3);
  EXPECT_EQ(queue.pop(), 4);
  EXPECT_EQ(queue.pop(), std::nullopt);
}

/// Counts how often an action is moved: more often while the queue has to grow.
struct CountedAction {
  explicit CountedAction(int& count) : moves(&count) {}
  CountedAction(CountedAction&& other) noexcept : moves(other.moves) { ++*moves; }
  CountedAction(const CountedAction&) = default;
  CountedAction& operator=(const CountedAction&) = default;
  int* moves;
};

TEST(ActionQueue, KeepsTheMemoryOfAFewActionsAndFreesThatOfABurst) {
  int moves = 0;
  const auto moves_after = [&](int burst) {
    ActionQueue<CountedAction> queue;
    for (int i = 0; i < burst; ++i) queue.push(CountedAction(moves));
    while (queue.pop()) continue;
    moves = 0;
    for (int i = 0; i < 100; ++i) queue.push(CountedAction(moves));
    return moves;
  };
  EXPECT_EQ(moves_after(200), 100) << "nothing grows";
  EXPECT_GT(moves_after(10000), 100) << "it begins small again";
}

}  // namespace
}  // namespace slamgw
