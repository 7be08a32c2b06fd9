// SPDX-License-Identifier: Apache-2.0
// Waits between attempts to connect: they double, with jitter, so that many gateways do not come
// back at the same time. Waits are short in the first minutes of an outage, because a broker that
// restarts is back soon. Pure.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

class Backoff {
 public:
  /// Limits the step to `longest` until `time` has passed since the first wait after reset().
  struct Eager {
    std::chrono::milliseconds longest;
    Duration time;
  };

  Backoff(std::chrono::milliseconds first, std::chrono::milliseconds longest, Eager eager = {})
      : first_(first), longest_(longest), eager_(eager), next_(first) {}

  /// Returns a wait between half of the present step and all of it. `jitter` is in [0, 1), from the
  /// caller's random source.
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

/// Detects a rival, which is a second client with the same client id, and makes the pauses grow.
/// Otherwise the two would take the connection from each other without end (MQTT 5 section 3.1.4)
/// and keep the broker busy. Pure.
class RivalWatch {
 public:
  /// A connection that lasts this long rules out a rival. After a pause of ours the limit is
  /// longer, because the rival pauses too.
  static constexpr std::chrono::seconds stable_after{10};
  static constexpr std::chrono::seconds first_pause{2};
  static constexpr std::chrono::seconds longest_pause{300};
  /// Not every broker says why it ends a connection: this many short ones in a row are a sign, too.
  static constexpr unsigned suspicious_lives = 2;

  void on_up(TimePoint now) { up_since_ = now; }
  /// Returns true when a rival is likely. `is_taken_over`: the broker has reported one.
  /// `may_be_for_a_message`: the broker may have closed the connection for a message that was under
  /// way or just refused, which is not a sign of a rival.
  bool on_lost(bool is_taken_over, bool may_be_for_a_message, TimePoint now) {
    const Duration lived = now - up_since_;
    const bool is_short = lived < std::max<Duration>(stable_after, 3 * pause_) &&
                          (is_taken_over || !may_be_for_a_message);
    short_lives_ = is_short ? short_lives_ + 1 : 0;
    const bool is_suspected = is_taken_over || short_lives_ >= suspicious_lives;
    const bool is_again = is_short && pause_ > Duration::zero();
    pause_ = !is_suspected ? Duration::zero()
             : is_again    ? std::min<Duration>(2 * pause_, longest_pause)
                           : Duration{first_pause};
    return is_suspected;
  }

  /// Returns the pause before the next attempt; 0 when no rival is suspected.
  Duration pause() const { return pause_; }

 private:
  TimePoint up_since_{};
  unsigned short_lives_ = 0;
  Duration pause_{0};
};

}  // namespace slamgw
