// SPDX-License-Identifier: Apache-2.0
// Decides which robot messages are worth a line (`log.traffic`): a journal entry costs a Pi's card
// more than the message itself. Pure.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"
#include "daemon/core/token_bucket.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log_settings.hpp"

namespace slamgw {

// Bounds how many lines of one kind are logged: journald drops whatever comes too fast, so a flood
// of lines would push out those that matter. Pure.

/// Lets lines pass up to a rate. Faster lines are a flood, and none passes until it is over: until
/// fewer lines came in a `window` than the rate allows.
class FloodGate {
 public:
  static constexpr std::chrono::seconds window{10};

  FloodGate(unsigned at_once, unsigned per_second) : at_once_(at_once), per_second_(per_second) {}

  bool take(TimePoint now) {
    const bool is_shut = now < shut_until_;
    const bool goes_on = held_back_ > per_second_ * window.count() && now < shut_until_ + window;
    if (!is_shut) held_back_ = 0;
    if (!is_shut && !goes_on && budget_.take(at_once_, per_second_, now)) return true;
    if (!is_shut) shut_until_ = now + window;
    ++held_back_;
    return false;
  }

 private:
  unsigned at_once_;
  unsigned per_second_;
  TokenBucket budget_;
  TimePoint shut_until_{};
  std::int64_t held_back_ = 0;  // in this window
};

/// All lines about clients that are not proven (Report::is_proven). Robots that only publish are
/// among them: each has a line a second, which must not take those of presence and refusals.
class UnprovenLines {
 public:
  static constexpr unsigned lines_at_once = 100;
  static constexpr unsigned lines_per_second = 40;
  static constexpr unsigned traffic_lines_per_second = 80;

  /// A line about presence or a refusal.
  bool may_write(const std::string& robot, TimePoint now) { return take(gate_, robot, now); }
  /// A line about a message.
  bool may_write_traffic(const std::string& robot, TimePoint now) {
    return take(traffic_gate_, robot, now);
  }
  /// One line for all that were left out since the last call; to be called every few seconds.
  std::optional<Notice> summary();

 private:
  bool take(FloodGate& gate, const std::string& robot, TimePoint now) {
    if (gate.take(now)) return true;
    ++left_out_;
    last_ = robot;
    return false;
  }

  FloodGate gate_{lines_at_once, lines_per_second};
  FloodGate traffic_gate_{lines_at_once, traffic_lines_per_second};
  std::uint64_t left_out_ = 0;
  std::string last_;
};

/// How many messages a line stands for.
struct TrafficLine {
  std::uint64_t of_stream = 1;  ///< this robot's, in this direction, of this type
  std::uint64_t of_others = 0;  ///< of any robot, left out because there were too many lines
};

/// `sampled`: the first of each robot, direction and type, then at most one a second, which says
/// how many it stands for.
class TrafficSampler {
 public:
  /// Streams of proven clients that are sampled one by one, and of all others; all further ones
  /// share one budget. So do all types of a robot but the first ones.
  static constexpr std::size_t max_streams = 65536;
  static constexpr std::size_t max_types = 16;
  /// Never more than 9 000 lines in 30 s, where journald takes 10 000 of a service unless its unit
  /// says otherwise (RateLimitBurst= in journald.conf(5)). The rest is left for what matters.
  static constexpr unsigned lines_at_once = 3000;
  static constexpr unsigned lines_per_second = 200;

  /// `unproven` outlives it.
  TrafficSampler(TrafficLogMode mode, UnprovenLines& unproven)
      : mode_(mode), unproven_(&unproven) {}

  /// What the line for this message stands for; nothing when it gets no line.
  std::optional<TrafficLine> on_traffic(const TrafficEvent& event, TimePoint now);

 private:
  /// Of clients that are proven, or not.
  struct Streams {
    TokenBucket budget;
    std::uint64_t without_line = 0;
    /// By the hash of robot, type and direction; two streams that share one share their lines.
    std::unordered_map<std::size_t, LogThrottle> streams;
    std::unordered_map<std::size_t, std::size_t> types;  // by the hash of the robot
  };

  std::optional<std::uint64_t> sample(const TrafficEvent& event, TimePoint now);

  TrafficLogMode mode_;
  UnprovenLines* unproven_;
  Streams streams_[2];  // by whether the client is proven
  std::string stream_;  // of the current message; kept, so that its memory is reused
};

}  // namespace slamgw
