// SPDX-License-Identifier: Apache-2.0
// Messages that wait for one page. Only the newest text of each state waits. When the page is slow,
// the oldest events are dropped, and the page gets their number. Pure; pages share the texts.
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
  /// About two seconds of a hundred robots: a page that is further behind needs the newest events.
  static constexpr std::size_t max_event_bytes = 256 * 1024;
  /// As much as LastKnown and Roster may hold, and over half as much for withdrawn states. A page
  /// that lets more wait has gone.
  static constexpr std::size_t max_state_bytes = 40 << 20;

  /// Queues the text, or replaces the waiting one of `topic`. False when there is no room: give up
  /// the page then, because it would show wrong states for ever.
  bool push_state(std::string_view topic, SharedText text);
  /// Drops the waiting states, but not the past. After `text`, all states are pushed again.
  void reset(std::string_view topic, SharedText text);
  /// Returns how many older events were dropped for it.
  std::uint64_t push_event(SharedText text);
  /// take() stops at this size; the next write takes the remaining messages.
  static constexpr std::size_t enough_bytes = 64 * 1024;

  /// Removes and returns a message, states before events; null when none waits.
  SharedText pop();
  /// Removes and returns several messages, a line each; empty when none waits.
  std::string take();

 private:
  std::deque<std::string> order_;  ///< topics of states
  std::map<std::string, SharedText, std::less<>> states_;
  std::size_t state_bytes_ = 0;
  std::deque<SharedText> events_;
  std::size_t event_bytes_ = 0;
  std::uint64_t unreported_drops_ = 0;
};

}  // namespace slamgw::web
