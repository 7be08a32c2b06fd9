// SPDX-License-Identifier: Apache-2.0
// The smoothed round trip to one peer and its variation (RFC 6298 section 2): they say how long to
// wait before an unanswered message is repeated. Pure; the caller decides when to measure and how
// to back off.
#pragma once

#include "daemon/core/time.hpp"

namespace slamgw {

class RoundTrip {
 public:
  /// `granularity` (G of RFC 6298): smaller differences between round trips do not count.
  explicit RoundTrip(Duration granularity) : granularity_(granularity) {}

  /// Takes the round trip of a request that was sent only once.
  void on_answer(Duration round_trip);
  bool is_known() const { return smoothed_ != Duration::zero(); }
  /// Returns how long to wait for an answer, without any bounds. Call only when is_known().
  Duration timeout() const;

 private:
  Duration granularity_;
  Duration smoothed_{};  // zero: no answer yet
  Duration variation_{};
};

}  // namespace slamgw
