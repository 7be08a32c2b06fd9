// SPDX-License-Identifier: Apache-2.0
// Counts one robot's messages and commands, and measures how long its messages take to be safe.
// Bounded: a few counters, and at most 2 KiB of latencies. Pure; part of the registry.
// LatencyHistogram counts the latencies of a whole mesh; part of Gateway.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

#include "daemon/core/time.hpp"

namespace slamgw {

/// Messages per second over the last five to ten seconds.
class RateMeter {
 public:
  void on_message(TimePoint now);
  double per_second(TimePoint now) const;

 private:
  TimePoint window_start_{};
  std::uint32_t in_window_ = 0;
  std::uint32_t in_previous_ = 0;
};

/// The newest latencies of the last minute.
class LatencyWindow {
 public:
  static constexpr std::size_t max_samples = 256;
  static constexpr std::chrono::seconds length{60};

  struct Percentiles {
    std::chrono::microseconds p50{0};
    std::chrono::microseconds p99{0};
  };

  void add(std::chrono::microseconds latency, TimePoint now);
  /// Returns nothing when no message of the last minute has become safe.
  std::optional<Percentiles> percentiles(TimePoint now) const;

 private:
  /// Milliseconds of the monotonic clock. They wrap after 49 days, so only use differences of up to
  /// a minute.
  using Stamp = std::uint32_t;
  static Stamp stamp(TimePoint now);
  struct Sample {
    std::uint32_t latency_us = 0;
    Stamp at = 0;
  };

  std::vector<Sample> samples_;  // a ring when full
  std::size_t next_ = 0;
};

/// Counts latencies since the daemon started, so that gateways' counts can be added up.
class LatencyHistogram {
 public:
  /// Upper bounds in microseconds: from a broker on this host to the QoS 0 limit of 10 s.
  static constexpr std::array<std::uint32_t, 14> bounds_us{
      500,     1'000,   2'500,   5'000,     10'000,    25'000,    50'000,
      100'000, 250'000, 500'000, 1'000'000, 2'500'000, 5'000'000, 10'000'000};

  void add(std::chrono::microseconds latency);
  /// Returns for each bound the number of latencies up to it.
  const std::array<std::uint64_t, bounds_us.size()>& at_most() const { return at_most_; }
  std::uint64_t count() const { return count_; }
  std::chrono::microseconds sum() const { return sum_; }

 private:
  std::array<std::uint64_t, bounds_us.size()> at_most_{};
  std::uint64_t count_ = 0;
  std::chrono::microseconds sum_{0};
};

class RobotNumbers {
 public:
  /// A pause of more than this many usual intervals between a robot's messages is a gap.
  static constexpr int gap_factor = 3;
  /// Messages with shorter intervals were read together.
  static constexpr std::chrono::milliseconds at_once{5};
  /// A robot's usual interval is known after this many messages.
  static constexpr std::uint64_t messages_to_know = 8;

  /// `bytes`: size of the payload.
  void on_up(std::size_t bytes, TimePoint now);
  void on_down(std::size_t bytes);
  void on_repeat() { ++repeats_; }
  /// One of the robot's messages reached the broker or the disk, `latency` after it came.
  void on_safe(std::chrono::microseconds latency, TimePoint now) { latency_.add(latency, now); }

  std::uint64_t up() const { return up_; }
  std::uint64_t down() const { return down_; }
  std::uint64_t bytes_up() const { return bytes_up_; }
  std::uint64_t bytes_down() const { return bytes_down_; }
  /// The robot's messages that came again and were not published again.
  std::uint64_t repeats() const { return repeats_; }
  /// Unusual pauses of the robot: an estimate of interruptions, not of lost messages.
  std::uint64_t gaps() const { return gaps_; }
  double rate_hz(TimePoint now) const { return rate_.per_second(now); }
  std::optional<LatencyWindow::Percentiles> latency(TimePoint now) const {
    return latency_.percentiles(now);
  }

 private:
  void note_interval(Duration interval);

  std::uint64_t up_ = 0;
  std::uint64_t down_ = 0;
  std::uint64_t bytes_up_ = 0;
  std::uint64_t bytes_down_ = 0;
  std::uint64_t repeats_ = 0;
  std::uint64_t gaps_ = 0;
  TimePoint last_up_{};
  Duration usual_interval_{};
  RateMeter rate_;
  LatencyWindow latency_;
};

}  // namespace slamgw
