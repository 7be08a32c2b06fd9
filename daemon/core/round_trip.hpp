// SPDX-License-Identifier: Apache-2.0
// The smoothed round trip to one peer and its variation (RFC 6298 section 2): how long to wait
// before a message that stays unanswered is repeated. Pure; when to measure, and how to back off,
// is the caller's.
#pragma once

#include "daemon/core/time.hpp"

namespace slamgw {

class RoundTrip {
 public:
  /// `granularity` (G of RFC 6298): differences between round trips that are no news.
  explicit RoundTrip(Duration granularity) : granularity_(granularity) {}

  /// A request that was sent once was answered so long after it was sent.
  void on_answer(Duration round_trip);
  bool is_known() const { return smoothed_ != Duration::zero(); }
  /// How long to wait for an answer, without any bounds; only when it is known.
  Duration timeout() const;

 private:
  Duration granularity_;
  Duration smoothed_{};  // zero: no answer yet
  Duration variation_{};
};

}  // namespace slamgw
