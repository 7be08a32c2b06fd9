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

// Bounds how many lines of one kind are logged: journald drops entries that come too fast, so a
// flood of lines would push out important ones. Pure.

/// Lets lines pass up to a rate. Faster lines are a flood: then no line passes until fewer lines
/// came in a `window` than the rate allows.
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
  std::int64_t held_back_ = 0;  // lines held back in this window
};

/// Bounds all lines about clients that are not proven (Report::is_proven). Robots that only publish
/// are among these: their line a second must not use up the lines about presence and refusals.
class UnprovenLines {
 public:
  static constexpr unsigned lines_at_once = 100;
  static constexpr unsigned lines_per_second = 40;
  static constexpr unsigned traffic_lines_per_second = 80;

  /// Returns whether a line about presence or a refusal may be written.
  bool may_write(const std::string& robot, TimePoint now) { return take(gate_, robot, now); }
  /// Returns whether a line about a message may be written.
  bool may_write_traffic(const std::string& robot, TimePoint now) {
    return take(traffic_gate_, robot, now);
  }
  /// Returns one notice for all lines left out since the last call. Call every few seconds.
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

/// The number of messages that a line stands for.
struct TrafficLine {
  std::uint64_t of_stream = 1;  ///< this robot's, in this direction, of this type
  std::uint64_t of_others = 0;  ///< of any robot, left out because there were too many lines
};

/// `sampled`: the first of each robot, direction and type, then at most one a second, which says
/// how many it stands for.
class TrafficSampler {
 public:
  /// This many streams of proven clients, and as many of other clients, are sampled one by one;
  /// further streams share one budget. A robot's types beyond `max_types` share another.
  static constexpr std::size_t max_streams = 65536;
  static constexpr std::size_t max_types = 16;
  /// Allows at most 9 000 lines in 30 s. By default, journald takes 10 000 of a service
  /// (RateLimitBurst= in journald.conf(5)); the rest is left for more important lines.
  static constexpr unsigned lines_at_once = 3000;
  static constexpr unsigned lines_per_second = 200;

  /// `unproven` must outlive this object.
  TrafficSampler(TrafficLogMode mode, UnprovenLines& unproven)
      : mode_(mode), unproven_(&unproven) {}

  /// Returns how many messages this message's line stands for; nothing when it gets no line.
  std::optional<TrafficLine> on_traffic(const TrafficEvent& event, TimePoint now);

 private:
  /// The streams of proven clients, or of other clients.
  struct Streams {
    TokenBucket budget;
    std::uint64_t without_line = 0;
    /// By the hash of robot, type and direction; two streams with the same hash share their lines.
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
