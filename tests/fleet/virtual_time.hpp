// SPDX-License-Identifier: Apache-2.0
// What simulated worlds rest on: a clock that jumps from event to event, and chance from a seed.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <queue>
#include <random>
#include <utility>

namespace slamgw::fleet::test {

using std::chrono::milliseconds;

class VirtualTime {
 public:
  void run(milliseconds span) {
    const milliseconds end = now_ + span;
    while (!events_.empty() && events_.top().at <= end) {
      const Event event = events_.top();
      events_.pop();
      now_ = event.at;
      event.act();
    }
    now_ = end;
  }

 protected:
  explicit VirtualTime(std::uint32_t seed) : random_(seed) {}
  ~VirtualTime() = default;

  /// Events of one time happen in the order in which they were entered.
  void at(milliseconds when, std::function<void()> act) {
    events_.push({when, ++order_, std::move(act)});
  }
  bool chance(double probability) {
    return std::uniform_real_distribution<>(0, 1)(random_) < probability;
  }
  milliseconds between(milliseconds least, milliseconds most) {
    return milliseconds(
        std::uniform_int_distribution<std::int64_t>(least.count(), most.count())(random_));
  }

  std::mt19937 random_;
  milliseconds now_{0};

 private:
  struct Event {
    milliseconds at{};
    std::uint64_t order = 0;
    std::function<void()> act;
    bool operator<(const Event& other) const {
      return std::pair(other.at, other.order) < std::pair(at, order);
    }
  };

  std::uint64_t order_ = 0;
  std::priority_queue<Event> events_;
};

}  // namespace slamgw::fleet::test
