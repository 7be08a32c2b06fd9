// SPDX-License-Identifier: Apache-2.0
// Commands for names that no robot has. A robot may be known a moment later, so each waits here for
// `patience` before it is refused. Pure; part of Gateway, for the first gateway of a broker by
// name.
#pragma once

#include <deque>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

class StrayCommands {
 public:
  /// With the 29 s that a mesh may take afterwards, a command still ends within 30 s.
  static constexpr std::chrono::milliseconds patience{500};
  /// Beyond these bounds the oldest are refused at once, so invented names cost no more memory.
  static constexpr std::size_t max_waiting = 4096;
  static constexpr std::size_t max_octets = std::size_t{8} * 1024 * 1024;

  struct Stray {
    BrokerMessage message;
    std::string robot;
    TimePoint came{};
  };

  void add(BrokerMessage message, std::string_view robot, TimePoint now);
  /// Those that have waited for long enough, and those that there is no room for; oldest first.
  std::vector<Stray> take_overdue(TimePoint now);
  /// Those for one robot, oldest first.
  std::vector<Stray> take_for(std::string_view robot);
  void clear() {
    waiting_.clear();
    octets_ = 0;
  }
  std::optional<TimePoint> deadline() const;

 private:
  std::deque<Stray> waiting_;  // in the order they came
  std::size_t octets_ = 0;     // of their payloads
};

}  // namespace slamgw
