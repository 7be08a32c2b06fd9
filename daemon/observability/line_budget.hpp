// SPDX-License-Identifier: Apache-2.0
// Bounds how many lines of one kind are logged: journald drops whatever comes too fast, so a flood
// of lines would push out those that matter. Pure.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

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

}  // namespace slamgw
