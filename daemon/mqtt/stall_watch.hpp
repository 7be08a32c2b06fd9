// SPDX-License-Identifier: Apache-2.0
// Whether the broker still reads what it is sent. A connection to a broker that stands still stays
// open, and the kernels on both sides take megabytes for it; QoS 0 has no answer, and would come
// out whenever the broker goes on. So the broker is asked something every second while something is
// sent, and every keep-alive while nothing is. Pure; part of Upstream.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <utility>

#include "daemon/core/time.hpp"

namespace slamgw {

class StallWatch {
 public:
  static constexpr std::chrono::seconds interval{1};
  /// After this time without an answer, messages that must not be late (QoS 0) are held back.
  static constexpr std::chrono::seconds silent_after{2};
  /// Then the connection is given up: what was sent in the second before the question is not ten
  /// seconds old yet (docs/topics.md, promise 5). A shorter keep-alive shortens it: a silent
  /// broker is left two keep-alives after its last answer at most.
  static constexpr std::chrono::seconds stalled_after{8};

  enum class Step : std::uint8_t { none, ask, silent, stalled };

  void on_link_up(std::chrono::seconds keep_alive, TimePoint now) {
    keep_alive_ = keep_alive;
    begin(now);
  }
  void on_link_down() { *this = {}; }
  /// True when that makes the deadline an earlier one.
  bool on_sent() { return !std::exchange(is_sent_, true) && !asked_; }
  /// True when the broker was called silent and no longer is.
  bool on_answer(TimePoint now) {
    const bool was_silent = is_silent_;
    const bool is_sent = is_sent_;  // after the question
    begin(now);
    is_sent_ = is_sent;
    return was_silent;
  }

  /// Nothing: the link is down.
  std::optional<TimePoint> deadline() const {
    if (!answered_) return std::nullopt;
    if (!asked_) return *answered_ + (is_sent_ ? std::min(interval, keep_alive_) : keep_alive_);
    return *asked_ + (is_silent_ ? patience() : std::min(silent_after, patience()));
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
  /// From the question to the end.
  std::chrono::seconds patience() const { return std::min(stalled_after, keep_alive_); }

 private:
  void begin(TimePoint now) {
    is_sent_ = is_silent_ = false;
    answered_ = now;
    asked_.reset();
  }

  std::chrono::seconds keep_alive_{0};
  bool is_sent_ = false;
  bool is_silent_ = false;
  std::optional<TimePoint> answered_;
  std::optional<TimePoint> asked_;
};

}  // namespace slamgw
