// SPDX-License-Identifier: Apache-2.0
// How long to wait before the next attempt: doubling with jitter, so that many gateways do not come
// back as one.
#pragma once

#include <algorithm>
#include <chrono>

namespace slamgw {

class Backoff {
 public:
  Backoff(std::chrono::milliseconds first, std::chrono::milliseconds longest)
      : first_(first), longest_(longest), next_(first) {}

  /// `jitter` in [0, 1) from the caller's random source: the wait is between half and all of the
  /// present step.
  std::chrono::milliseconds next_wait(double jitter) {
    const auto step = next_;
    next_ = std::min(longest_, 2 * next_);
    return std::chrono::duration_cast<std::chrono::milliseconds>(step * (0.5 + 0.5 * jitter));
  }

  void reset() { next_ = first_; }

 private:
  std::chrono::milliseconds first_;
  std::chrono::milliseconds longest_;
  std::chrono::milliseconds next_;
};

}  // namespace slamgw
