// SPDX-License-Identifier: Apache-2.0
// A rate with a burst: a number of tokens at once, then one in each interval. Pure.
#pragma once

#include <algorithm>

#include "daemon/core/time.hpp"

namespace slamgw {

class TokenBucket {
 public:
  /// Takes a token: `burst` of them at once, then one each `interval`. Returns false, and takes
  /// nothing, when there is none.
  bool take(unsigned burst, Duration interval, TimePoint now) {
    const TimePoint after = std::max(taken_until_, now) + interval;
    if (after - now > interval * burst) return false;
    taken_until_ = after;
    return true;
  }
  bool take(unsigned burst, unsigned per_second, TimePoint now) {
    return take(burst, Duration(std::chrono::seconds{1}) / per_second, now);
  }

 private:
  // When the bucket will be full again; at or before `now` when it is full.
  TimePoint taken_until_{};
};

}  // namespace slamgw
