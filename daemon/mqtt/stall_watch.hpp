// SPDX-License-Identifier: Apache-2.0
// Whether the broker still reads what it is sent. A connection to a broker that stands still stays
// open, and the kernels on both sides take megabytes for it; QoS 0 has no answer, and would come
// out whenever the broker goes on. So while something is sent, the broker is asked something every
// second. Pure; part of Upstream.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

class StallWatch {
 public:
  static constexpr std::chrono::seconds interval{1};
  /// After so long without an answer nothing more is sent that may not be late.
  static constexpr std::chrono::seconds silent_after{2};
  /// Then the connection is given up: what was sent in the second before the question is not ten
  /// seconds old yet (contract, promise 5).
  static constexpr std::chrono::seconds stalled_after{8};

  enum class Step : std::uint8_t { none, ask, silent, stalled };

  void on_link_up(TimePoint now) { begin(now); }
  void on_link_down() { *this = {}; }
  void on_sent() { is_sent_ = true; }
  /// True when the broker was called silent and no longer is.
  bool on_answer(TimePoint now) {
    const bool was_silent = is_silent_;
    const bool is_sent = is_sent_;
    begin(now);
    is_sent_ = is_sent;  // after the question
    return was_silent;
  }

  /// Nothing: nothing was sent.
  std::optional<TimePoint> deadline() const {
    if (asked_) return *asked_ + (is_silent_ ? stalled_after : silent_after);
    return is_sent_ ? std::optional(answered_ + interval) : std::nullopt;
  }
  /// What is to be done now.
  Step on_deadline(TimePoint now) {
    const auto due = deadline();
    if (!due || now < *due) return Step::none;
    if (!asked_) {
      asked_ = now;
      is_sent_ = false;
      return Step::ask;
    }
    if (is_silent_) return Step::stalled;
    is_silent_ = true;
    return Step::silent;
  }

 private:
  void begin(TimePoint now) {
    *this = {};
    answered_ = now;
  }

  bool is_sent_ = false;
  bool is_silent_ = false;
  TimePoint answered_{};
  std::optional<TimePoint> asked_;
};

}  // namespace slamgw
