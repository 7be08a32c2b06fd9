// SPDX-License-Identifier: Apache-2.0
// How many messages of each topic are in a place, in bounded memory: a table of counters by the
// topic's hash. Two topics may share a counter; "none" is always true, "some" may mean the other
// topic, and costs that one a detour through the store. Used by the backlog.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>
#include <vector>

namespace slamgw {

class TopicCounts {
 public:
  /// 256 KiB; a thousand robots with three topics each rarely share a slot.
  static constexpr std::size_t slots = 65536;

  static std::size_t slot(std::string_view topic) {
    return std::hash<std::string_view>{}(topic) % slots;
  }

  void add(std::string_view topic) { ++counts_[slot(topic)]; }
  /// Only what was added before.
  void remove(std::string_view topic) { --counts_[slot(topic)]; }
  bool has(std::string_view topic) const { return counts_[slot(topic)] > 0; }

 private:
  std::vector<std::uint32_t> counts_ = std::vector<std::uint32_t>(slots);
};

}  // namespace slamgw
