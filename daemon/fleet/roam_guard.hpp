// SPDX-License-Identifier: Apache-2.0
// Holds back claims for a robot that is claimed again and again: two robots with one name, or one
// between two radios. Pure; part of Ownership.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <string>

#include "daemon/core/time.hpp"

namespace slamgw::fleet {

class RoamGuard {
 public:
  /// So many claims in a row are a robot that walks.
  static constexpr unsigned free_claims = 3;
  /// A robot that was claimed so long ago begins anew.
  static constexpr std::chrono::seconds calm{30};
  static constexpr std::chrono::seconds first_pause{3};
  static constexpr std::chrono::seconds longest_pause{60};
  /// Beyond it the calm ones are forgotten; if all are restless, a robot is not guarded.
  static constexpr std::size_t max_robots = 20'000;

  /// Whether this gateway may claim the robot from a living owner now.
  bool may_claim(const std::string& robot, TimePoint now) const {
    const auto entry = entries_.find(robot);
    return entry == entries_.end() || now >= entry->second.next;
  }
  /// How many claims in a row there were with this one.
  unsigned on_claim(const std::string& robot, TimePoint now) {
    if (entries_.size() >= max_robots)
      std::erase_if(entries_, [&](const auto& each) { return now - each.second.last > calm; });
    if (entries_.size() >= max_robots) return 1;
    Entry& entry = entries_[robot];
    if (now - entry.last > calm + pause_after(entry.claims)) entry.claims = 0;
    ++entry.claims;
    entry.last = now;
    entry.next = now + pause_after(entry.claims);
    return entry.claims;
  }

 private:
  struct Entry {
    unsigned claims = 0;
    TimePoint last{};
    TimePoint next{};
  };
  static Duration pause_after(unsigned claims) {
    if (claims < free_claims) return Duration::zero();
    const unsigned doublings = std::min(claims - free_claims, 5U);
    return std::min<Duration>(first_pause * (1U << doublings), longest_pause);
  }

  std::map<std::string, Entry> entries_;
};

}  // namespace slamgw::fleet
