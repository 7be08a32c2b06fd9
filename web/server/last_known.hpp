// SPDX-License-Identifier: Apache-2.0
// The newest message on each state topic. A new page gets these, and the metrics are made of them.
// Pure, bounded.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "web/server/page_queue.hpp"

namespace slamgw::web {

class LastKnown {
 public:
  /// Enough for ten thousand robots on a few gateways. The bound is needed because every client
  /// that may publish under the prefix could make more topics.
  static constexpr std::size_t max_topics = 20'000;
  static constexpr std::size_t max_bytes = 16 << 20;

  /// `own`: the beginning of one gateway's topics, which may use a quarter more than all the room.
  explicit LastKnown(std::string own = "/") : own_(std::move(own)) {}

  /// Keeps the text in place of the older one; returns false, and changes nothing, when there is no
  /// room. Do not call for an empty payload, which withdraws a retained message: call forget().
  bool keep(std::string_view topic, const SharedText& text);
  /// Returns whether the topic was known.
  bool forget(std::string_view topic);
  void forget_all();
  const std::map<std::string, SharedText, std::less<>>& topics() const { return topics_; }

 private:
  std::map<std::string, SharedText, std::less<>> topics_;
  std::size_t bytes_ = 0;
  const std::string own_;
};

}  // namespace slamgw::web
