// SPDX-License-Identifier: Apache-2.0
// Decides when a repeated event is worth a log line, and how many events that line stands for: the
// first of a burst at once, then at most one line for each interval.
#pragma once

#include <cstdint>
#include <optional>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw {

class LogThrottle {
 public:
  /// Allows at most one line each `interval`.
  explicit LogThrottle(Duration interval = std::chrono::seconds{10}) : interval_(interval) {}

  /// Counts one more event. If a line is due now, returns how many events it stands for (1 for the
  /// first of a burst).
  std::optional<std::uint64_t> on_event(TimePoint now) {
    ++pending_;
    if (last_line_at_ && now - *last_line_at_ < interval_) return std::nullopt;
    last_line_at_ = now;
    return std::exchange(pending_, 0);
  }

 private:
  Duration interval_;
  std::optional<TimePoint> last_line_at_;
  std::uint64_t pending_ = 0;
};

}  // namespace slamgw
