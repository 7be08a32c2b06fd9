// SPDX-License-Identifier: Apache-2.0
// Finds the frame borders again, whatever the board was in the middle of: 255 zero octets complete
// any torn command, then an Echo with a fresh nonce proves that a board with Nordic's serial
// firmware is there and marks the border in its answers. Also how every connection starts. Called
// by BoardLink, which throws away what else arrives meanwhile.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <random>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

class Resync {
 public:
  static constexpr Duration quiet_time = std::chrono::milliseconds{300};
  /// On a busy mesh the board is never quiet; the nonce alone then has to find the border.
  static constexpr Duration max_wait_for_quiet = std::chrono::seconds{1};
  /// Of each attempt. A board that was just reset may be silent for seconds, or answer late.
  static constexpr std::array<Duration, 5> echo_time_limits{
      std::chrono::milliseconds{500}, std::chrono::seconds{2}, std::chrono::seconds{2},
      std::chrono::seconds{2}, std::chrono::seconds{2}};

  enum class State : std::uint8_t { idle, waiting, in_step, failed };

  explicit Resync(std::uint64_t seed) : random_(seed) {}

  /// Forgets an earlier attempt. Returns what to write.
  Bytes start(TimePoint now);
  /// Returns what follows the border once it was found; empty until then.
  ByteView on_bytes(ByteView bytes, TimePoint now);
  std::optional<TimePoint> deadline() const;
  /// Returns what to write, if anything.
  std::optional<Bytes> on_deadline(TimePoint now);

  State state() const { return state_; }
  /// Octets that came since `start`: none means that no board answers.
  std::size_t octets_seen() const { return octets_seen_; }
  /// A zero was refused as only Nordic's firmware does, so that it is there even without an Echo.
  bool has_seen_refusal() const { return has_seen_refusal_; }

 private:
  enum class Phase : std::uint8_t { waiting_for_quiet, waiting_for_echo };

  Bytes flush(TimePoint now);

  std::mt19937_64 random_;
  State state_ = State::idle;
  Phase phase_ = Phase::waiting_for_quiet;
  std::size_t attempts_ = 0;
  std::size_t octets_seen_ = 0;
  std::uint32_t last_octets_ = 0;  ///< the last four received
  bool has_seen_refusal_ = false;
  TimePoint due_{};
  TimePoint quiet_limit_{};
  Bytes awaited_;  ///< the Echo's answer as it comes over the wire
  Bytes tail_;     ///< the last octets received, fewer than `awaited_`
};

}  // namespace slamgw::ble
