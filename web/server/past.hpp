// SPDX-License-Identifier: Apache-2.0
// Messages that a later page has missed: robots' updates, commands and their outcomes of the last
// 24 hours, within 16 MiB. When there is no more room, the robot with the most updates loses every
// second update of the older half: the distant past keeps fewer points. Pure, in memory.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "web/server/page_queue.hpp"

namespace slamgw::web {

class Past {
 public:
  static constexpr std::int64_t length_ms = 24 * 3600 * 1000LL;
  static constexpr std::size_t max_updates = 320'000;  ///< 32 octets each
  static constexpr std::size_t max_robots = 2000;
  static constexpr std::size_t max_event_bytes = 3 << 20;
  /// Limits of what a page gets: as many updates of one robot as a page keeps points, about 2 MiB
  /// of all robots, and as many events as a page keeps messages.
  static constexpr std::size_t max_told_of_one = 4000;
  static constexpr std::size_t max_told = 50'000;
  static constexpr std::size_t max_told_events = 3000;

  /// `payload`: positions, or the JSON that docs/topics.md describes; ignores others.
  void on_update(std::string_view robot, std::string_view payload, std::int64_t at_ms);
  void on_event(SharedText text, std::int64_t at_ms);

  /// Returns messages by topic, for a page that has seen everything up to `since_ms`.
  std::vector<std::pair<std::string, SharedText>> texts(std::int64_t since_ms,
                                                        std::int64_t now_ms) const;
  std::size_t updates() const { return count_; }

 private:
  static constexpr std::size_t max_octets = 20;
  struct Update {
    std::int64_t at_ms = 0;
    std::uint8_t size = 0;
    std::array<std::uint8_t, max_octets> octets{};
  };
  struct Event {
    std::int64_t at_ms = 0;
    SharedText text;
  };
  using Updates = std::deque<Update>;

  void make_room(std::int64_t now_ms);
  void drop_old(Updates& updates, std::int64_t now_ms);
  static std::string text_of(const std::string& robot, const Updates& updates,
                             std::int64_t since_ms, std::size_t most);

  std::map<std::string, Updates, std::less<>> robots_;
  std::size_t count_ = 0;
  std::int64_t searched_ms_ = 0;
  std::deque<Event> events_;
  std::size_t event_bytes_ = 0;
};

}  // namespace slamgw::web
