// SPDX-License-Identifier: Apache-2.0
// Paho's send thread can miss its signal and then sleeps for up to a second on a message
// (eclipse-paho/paho.mqtt.c 1.3.x). Another request wakes it. This says when one is due: nothing
// was acknowledged or published for a while although something is in flight. Pure.
#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

class SendNudge {
 public:
  /// So many times what an acknowledgement takes as a rule, within these limits: a broker on this
  /// host answers within a millisecond, one that is far away must not be asked for nothing.
  static constexpr int patience = 4;
  static constexpr std::chrono::milliseconds shortest_wait{3};
  static constexpr std::chrono::milliseconds first_wait{25};
  /// A broker that is only slow must not be flooded: each wait is twice the last one.
  static constexpr std::chrono::milliseconds longest_wait{1600};

  void on_publish(TimePoint now) {
    ++in_flight_;
    if (sample_left_ == 0) {
      sample_left_ = in_flight_;
      sample_begin_ = now;
    }
    on_progress(now);
  }
  void on_acknowledged(TimePoint now) {
    in_flight_ -= in_flight_ > 0 ? 1 : 0;
    if (sample_left_ > 0 && --sample_left_ == 0) usual_ += (now - sample_begin_ - usual_) / 8;
    on_progress(now);
  }
  void clear() { *this = {}; }

  /// Nothing: nothing is in flight.
  std::optional<TimePoint> deadline() const {
    if (in_flight_ == 0) return std::nullopt;
    return last_progress_ + wait_;
  }
  /// True when a nudge is due, which is then given.
  bool take(TimePoint now) {
    if (in_flight_ == 0 || now < last_progress_ + wait_) return false;
    last_progress_ = now;
    wait_ = std::min<Duration>(2 * wait_, longest_wait);
    return true;
  }

 private:
  void on_progress(TimePoint now) {
    last_progress_ = now;
    wait_ = std::clamp<Duration>(patience * usual_, shortest_wait, first_wait);
  }

  std::size_t in_flight_ = 0;
  TimePoint last_progress_{};
  Duration wait_ = first_wait;
  // One message at a time is watched from its publish to its acknowledgement, by counting.
  std::size_t sample_left_ = 0;  ///< acknowledgements until its own; 0: none is watched
  TimePoint sample_begin_{};
  Duration usual_ = Duration{first_wait} / patience;  ///< smoothed
};

}  // namespace slamgw
