// SPDX-License-Identifier: Apache-2.0
// The simulator's time types. Its machines get `now` as an argument; only the shells read a clock.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

namespace slamgw::sim {

using TimePoint = std::chrono::steady_clock::time_point;
using Duration = std::chrono::steady_clock::duration;

inline std::optional<TimePoint> first_of(std::optional<TimePoint> a, std::optional<TimePoint> b) {
  if (!a) return b;
  if (!b) return a;
  return std::min(*a, *b);
}

}  // namespace slamgw::sim
