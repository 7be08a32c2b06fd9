// SPDX-License-Identifier: Apache-2.0
// What waits for one page. Of a state only the newest waits; of events the oldest are dropped when
// the page is slow, and it gets their number. Pure; texts are shared among pages.
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
  /// is new.
  static constexpr std::size_t max_event_bytes = 256 * 1024;
  /// What LastKnown and Roster may hold, and more than half as much for what was taken back
  /// meanwhile. A page that lets more wait is not there any more.
  static constexpr std::size_t max_state_bytes = 40 << 20;

  /// Replaces the text of `topic` that waits, if one does. False when too many wait: the page is to
  /// be given up, for what it shows would be wrong for ever.
  bool push_state(std::string_view topic, SharedText text);
  /// Drops the states that wait: all of them come anew after `text`.
  void reset(std::string_view topic, SharedText text);
  void push_event(SharedText text);
  /// One write for many messages: beyond this size the next write takes what is left.
  static constexpr std::size_t enough_bytes = 64 * 1024;

  /// States first, then events; nothing (null) when nothing waits.
  SharedText pop();
  /// Several of them at once, a line each; empty when nothing waits.
  std::string take();

  std::uint64_t dropped() const { return dropped_; }  ///< events, since the page came

 private:
  std::deque<std::string> order_;  ///< topics of states
  std::map<std::string, SharedText, std::less<>> states_;
  std::size_t state_bytes_ = 0;
  std::deque<SharedText> events_;
  std::size_t event_bytes_ = 0;
  std::uint64_t dropped_ = 0;
  std::uint64_t unreported_drops_ = 0;
};

}  // namespace slamgw::web
