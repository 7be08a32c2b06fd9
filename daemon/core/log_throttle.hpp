// SPDX-License-Identifier: Apache-2.0
// "Counted always, said once per burst": decides when a repeated event is worth a line, and how
// many it stands for.
#pragma once

#include <cstdint>
#include <optional>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw {

class LogThrottle {
 public:
  /// At most one line each `interval`.
  explicit LogThrottle(Duration interval = std::chrono::seconds{10}) : interval_(interval) {}

  /// One more event. A number when a line is due now: how many events it stands for (1 for the
  /// first of a burst).
  std::optional<std::uint64_t> on_event(TimePoint now) {
    ++pending_;
    if (last_said_ && now - *last_said_ < interval_) return std::nullopt;
    last_said_ = now;
    return std::exchange(pending_, 0);
  }

 private:
  Duration interval_;
  std::optional<TimePoint> last_said_;
  std::uint64_t pending_ = 0;
};

}  // namespace slamgw
