// SPDX-License-Identifier: Apache-2.0
// How many lines of one kind the log takes: what floods it must not push out what matters, and
// journald drops what comes too fast, whatever it is. Pure.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

/// Lines in a row, then so many a second.
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

}  // namespace slamgw
