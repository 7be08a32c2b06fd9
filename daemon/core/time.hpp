// SPDX-License-Identifier: Apache-2.0
// The time types of the pure code. Time enters as an argument: nothing here, and nothing that
// includes only this, reads a clock.
#pragma once

#include <chrono>
#include <string>

namespace slamgw {

/// Monotonic time for every timer and timeout; immune to NTP steps and to a boot at 1970.
using TimePoint = std::chrono::steady_clock::time_point;
using Duration = std::chrono::steady_clock::duration;

/// Wall time, only for what people read ("since", "last_seen"). Never compared, never waited for.
using WallTime = std::chrono::system_clock::time_point;

/// One instant on both clocks, taken together by a shell.
struct Now {
  TimePoint mono{};
  WallTime wall{};
  /// For callers that need only this clock.
  operator TimePoint() const { return mono; }
};

/// `2026-11-21T06:31:07Z`, as every time in our topics.
std::string to_iso8601(WallTime time);
/// `2026-11-21T06:31:07.042Z`
std::string to_iso8601_ms(WallTime time);
/// `2026-11-21T06:31:07.042137Z`
std::string to_iso8601_us(WallTime time);

}  // namespace slamgw
