// SPDX-License-Identifier: Apache-2.0
// How long one robot takes to answer a command, and so when to repeat one: the smoothed round trip
// and its variation (RFC 6298). Called by CommandQueue.
#pragma once

#include <algorithm>

#include "daemon/core/round_trip.hpp"

namespace slamgw::ble {

class AnswerTime {
 public:
  /// However fast a robot answers: a command and its STATUS each wait for the advertisers of a few
  /// relays (20 ms and a random delay for each).
  static constexpr Duration shortest_timeout = std::chrono::milliseconds{100};
  /// Differences between round trips that are no news (G of RFC 6298).
  static constexpr Duration granularity = std::chrono::milliseconds{10};
  /// Doubling ends here; callers' own bounds are far below.
  static constexpr Duration longest_timeout = std::chrono::seconds{30};

  /// The wait before the first repeat: at most `longest`, which it also is before the first answer.
  Duration timeout(Duration longest) const {
    return timeout_ == Duration::zero() ? longest : std::min(timeout_, longest);
  }
  /// The robot answered a command that was sent once, this long after it was sent.
  void on_answer(Duration round_trip) {
    round_trip_.on_answer(round_trip);
    timeout_ = std::max(shortest_timeout, round_trip_.timeout());
  }
  /// It answered one that was sent several times, or did not answer. To which copy it answered
  /// is unknown (Karn's rule): it teaches no round trip, but the timeout doubles until one is
  /// measured again.
  void on_repeated() { timeout_ = std::min(2 * timeout_, longest_timeout); }

 private:
  RoundTrip round_trip_{granularity};
  Duration timeout_{};  ///< zero: unknown
};

}  // namespace slamgw::ble
