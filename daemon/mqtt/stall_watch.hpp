// SPDX-License-Identifier: Apache-2.0
// Detects a broker that no longer reads what it is sent. The connection to a broker that hangs
// stays open, and the kernels on both sides take megabytes for it. QoS 0 has no answer, and would
// arrive late, when the broker goes on. So the broker is asked a question every second while
// messages are sent, and every keep-alive otherwise. Pure; part of Upstream.
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
  /// After this time without an answer, the connection is given up: messages from the second before
  /// the question are not yet ten seconds old (docs/topics.md, promise 5). A shorter keep-alive
  /// shortens it: a silent broker is left at most two keep-alives after its last answer.
  static constexpr std::chrono::seconds stalled_after{8};

  enum class Step : std::uint8_t { none, ask, silent, stalled };

  void on_link_up(std::chrono::seconds keep_alive, TimePoint now) {
    keep_alive_ = keep_alive;
    begin(now);
  }
  void on_link_down() { *this = {}; }
  /// Returns true when the deadline is now an earlier one.
  bool on_sent() { return !std::exchange(is_sent_, true) && !asked_; }
  /// Returns true when this ends a reported silence.
  bool on_answer(TimePoint now) {
    const bool was_silent = is_silent_;
    const bool is_sent = is_sent_;  // after the question
    begin(now);
    is_sent_ = is_sent;
    return was_silent;
  }

  /// Returns nothing while the link is down.
  std::optional<TimePoint> deadline() const {
    if (!answered_) return std::nullopt;
    if (!asked_) return *answered_ + (is_sent_ ? std::min(interval, keep_alive_) : keep_alive_);
    return *asked_ + (is_silent_ ? patience() : std::min(silent_after, patience()));
  }
  /// Returns the step to take now.
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
  /// Returns the time from an unanswered question to the end of the connection.
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
