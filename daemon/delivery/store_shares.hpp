// SPDX-License-Identifier: Apache-2.0
// What each flow has in the store, so that none takes all of it. A flow is what a topic has in
// front of its last level: all types of one robot are one flow. In bounded memory, as TopicCounts:
// flows whose names share a slot share what they may have. Used by the backlog.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <unordered_map>

namespace slamgw {

inline std::string_view flow_of(std::string_view topic) {
  return topic.substr(0, topic.rfind('/'));
}

class StoreShares {
 public:
  struct Share {
    std::string flow;
    std::uint64_t bytes = 0;
  };
  /// As many robots as a gateway knows rarely share one.
  static constexpr std::size_t slots = 65536;

  void add(std::string_view topic, std::uint64_t bytes) {
    Share& share = shares_[slot(topic)];
    if (share.bytes == 0) share.flow = flow_of(topic);
    share.bytes += bytes;
  }
  /// What was added before, or less.
  void remove(std::string_view topic, std::uint64_t bytes) {
    const auto share = shares_.find(slot(topic));
    if (share == shares_.end()) return;
    share->second.bytes -= std::min(share->second.bytes, bytes);
    if (share->second.bytes == 0) shares_.erase(share);
  }
  std::uint64_t bytes_of(std::string_view topic) const {
    const auto share = shares_.find(slot(topic));
    return share == shares_.end() ? 0 : share->second.bytes;
  }
  /// Looks at all of them.
  Share largest() const {
    Share largest;
    for (const auto& [slot, share] : shares_)
      if (share.bytes > largest.bytes) largest = share;
    return largest;
  }

 private:
  static std::size_t slot(std::string_view topic) {
    return std::hash<std::string_view>{}(flow_of(topic)) % slots;
  }

  std::unordered_map<std::size_t, Share> shares_;  // by slot; none is empty
};

}  // namespace slamgw
