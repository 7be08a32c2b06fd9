// SPDX-License-Identifier: Apache-2.0
// What waits for one page. Of a state only the newest waits; of events the oldest are dropped when
// the page is slow, and it is told how many. Pure; texts are shared among pages.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <string_view>

namespace slamgw::web {

using SharedText = std::shared_ptr<const std::string>;

class PageQueue {
 public:
  /// About two seconds of a hundred robots: a page that is further behind is better off with what
  /// is new. States have no bound of their own: each waits once, and LastKnown bounds them.
  static constexpr std::size_t max_event_bytes = 256 * 1024;

  /// Replaces the text of `topic` that waits, if one does.
  void push_state(std::string_view topic, SharedText text);
  void push_event(SharedText text);
  /// States first, then events; nothing (null) when nothing waits.
  SharedText pop();

  bool is_empty() const { return states_.empty() && events_.empty() && untold_ == 0; }
  std::uint64_t dropped() const { return dropped_; }  ///< events, since the page came

 private:
  std::deque<std::string> order_;  ///< topics of states
  std::map<std::string, SharedText, std::less<>> states_;
  std::deque<SharedText> events_;
  std::size_t event_bytes_ = 0;
  std::uint64_t dropped_ = 0;
  std::uint64_t untold_ = 0;
};

}  // namespace slamgw::web
