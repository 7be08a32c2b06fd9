// SPDX-License-Identifier: Apache-2.0
// How long to wait before the next attempt: doubling with jitter, so that many gateways do not come
// back as one. Waits are short for the first minutes of an outage: a broker that restarts is back
// soon. Pure.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

class Backoff {
 public:
  /// The longest step while the first attempt since reset() is not longer ago than `time`.
  struct Eager {
    std::chrono::milliseconds longest;
    Duration time;
  };

  Backoff(std::chrono::milliseconds first, std::chrono::milliseconds longest, Eager eager = {})
      : first_(first), longest_(longest), eager_(eager), next_(first) {}

  /// `jitter` in [0, 1) from the caller's random source: the wait is between half and all of the
  /// present step.
  std::chrono::milliseconds next_wait(double jitter, TimePoint now) {
    if (!since_) since_ = now;
    const bool is_eager = now - *since_ < eager_.time;
    const auto step = is_eager ? std::min(next_, eager_.longest) : next_;
    next_ = std::min(longest_, 2 * next_);
    return std::chrono::duration_cast<std::chrono::milliseconds>(step * (0.5 + 0.5 * jitter));
  }

  void reset() {
    next_ = first_;
    since_.reset();
  }

 private:
  std::chrono::milliseconds first_;
  std::chrono::milliseconds longest_;
  Eager eager_;
  std::chrono::milliseconds next_;
  std::optional<TimePoint> since_;  // the first wait since reset()
};

}  // namespace slamgw
