// SPDX-License-Identifier: Apache-2.0
// The newest word on each state topic: what a page gets when it comes, and what the metrics are
// made of. Pure, bounded.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "web/server/page_queue.hpp"

namespace slamgw::web {

class LastKnown {
 public:
  /// Enough for ten thousand robots on a few gateways. Every client that may publish under the
  /// prefix could make more topics, hence the bound.
  static constexpr std::size_t max_topics = 20'000;
  static constexpr std::size_t max_bytes = 16 << 20;

  /// Topics that begin so, which are one gateway's, have a quarter more room than there is for all.
  explicit LastKnown(std::string own = "/") : own_(std::move(own)) {}

  /// False when there is no room. An empty payload, which takes a retained message back, is a text
  /// of its own that is not kept.
  bool keep(std::string_view topic, SharedText text);
  /// Whether it was known.
  bool forget(std::string_view topic);
  void forget_all();
  const std::map<std::string, SharedText, std::less<>>& topics() const { return topics_; }

 private:
  std::map<std::string, SharedText, std::less<>> topics_;
  std::size_t bytes_ = 0;
  const std::string own_;
};

}  // namespace slamgw::web
