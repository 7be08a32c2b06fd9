// SPDX-License-Identifier: Apache-2.0
// Decides which robot messages are worth a line (`log.traffic`): a journal entry costs a Pi's card
// more than the message itself. Pure.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/time.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log_settings.hpp"

namespace slamgw {

// Bounds how many lines of one kind are logged: journald drops whatever comes too fast, so a flood
// of lines would push out those that matter. Pure.

/// A burst of `at_once` lines, then `per_second` lines a second.
class LineBudget {
 public:
  LineBudget(std::int64_t at_once, std::int64_t per_second)
      : at_once_(at_once), interval_(Duration(std::chrono::seconds{1}) / per_second) {}

  /// False when there are too many.
  bool take(TimePoint now) {
    const TimePoint earliest = now - at_once_ * interval_;
    const TimePoint spent_until = std::max(spent_until_.value_or(earliest), earliest);
    if (spent_until + interval_ > now) return false;
    spent_until_ = spent_until + interval_;
    return true;
  }

 private:
  std::int64_t at_once_;
  Duration interval_;
  std::optional<TimePoint> spent_until_;
};

/// How many messages a line stands for.
struct TrafficLine {
  std::uint64_t of_stream = 1;  ///< this robot's, in this direction, of this type
  std::uint64_t of_others = 0;  ///< of any robot, left out because there were too many lines
};

/// `sampled`: the first of each robot, direction and type, then at most one a second, which says
/// how many it stands for.
class TrafficSampler {
 public:
  /// Streams that are sampled one by one; all further ones share one budget.
  static constexpr std::size_t max_streams = 65536;
  /// Never more than 9 000 lines in 30 s, where journald takes 10 000 of a service unless its unit
  /// says otherwise (RateLimitBurst= in journald.conf(5)). The rest is left for what matters.
  static constexpr std::int64_t lines_at_once = 3000;
  static constexpr std::int64_t lines_per_second = 200;

  explicit TrafficSampler(TrafficLogMode mode) : mode_(mode) {}

  /// What the line for this message stands for; nothing when it gets no line.
  std::optional<TrafficLine> on_traffic(const TrafficEvent& event, TimePoint now);

 private:
  std::optional<std::uint64_t> sample(const TrafficEvent& event, TimePoint now);

  TrafficLogMode mode_;
  LineBudget budget_{lines_at_once, lines_per_second};
  std::uint64_t without_line_ = 0;
  /// By the hash of robot, type and direction; two streams that share one share their lines.
  std::unordered_map<std::size_t, LogThrottle> streams_;
  std::string stream_;  // of the current message; kept, so that its memory is reused
};

}  // namespace slamgw
