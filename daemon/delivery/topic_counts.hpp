// SPDX-License-Identifier: Apache-2.0
// How many messages of each topic are in a place, in bounded memory: counters by the topic's hash,
// only those that are not zero, for as a rule there are none. Two topics may share a counter;
// "none" is always true, "some" may mean the other topic, and costs that one a detour through the
// store. Used by the backlog.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>
#include <unordered_map>

namespace slamgw {

class TopicCounts {
 public:
  /// A thousand robots with three topics each rarely share a slot.
  static constexpr std::size_t slots = 65536;

  static std::size_t slot(std::string_view topic) {
    return std::hash<std::string_view>{}(topic) % slots;
  }

  void add(std::string_view topic) { ++counts_[slot(topic)]; }
  /// Only what was added before.
  void remove(std::string_view topic) {
    const auto count = counts_.find(slot(topic));
    if (count != counts_.end() && --count->second == 0) counts_.erase(count);
  }
  bool has(std::string_view topic) const {
    return !counts_.empty() && counts_.contains(slot(topic));
  }

 private:
  std::unordered_map<std::size_t, std::uint32_t> counts_;  // by slot
};

}  // namespace slamgw
