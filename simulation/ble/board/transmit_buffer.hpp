// SPDX-License-Identifier: Apache-2.0
// The board's buffer towards its host. What does not fit is dropped, which only command 0x14 tells.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/bytes.hpp"
#include "simulation/time.hpp"

namespace slamgw::sim::ble {

class TransmitBuffer {
 public:
  /// Octets: two of the largest packets with their headers, as in Nordic's serial bearer.
  static constexpr std::size_t header_size = 4;
  static constexpr std::size_t capacity = 2 * (256 + header_size);

  /// An octet takes so long on the line; 0: no time.
  explicit TransmitBuffer(Duration octet_time) : octet_time_(octet_time) {}

  /// Puts the length octet in front.
  void push(const Bytes& opcode_and_params);
  /// The first packet, when it has gone over the line. Until then it takes up its room.
  std::optional<Bytes> pop(TimePoint now);
  /// When `pop` has the next packet, if not yet.
  std::optional<TimePoint> deadline() const { return is_over_ ? std::nullopt : sent_at_; }
  void on_deadline(TimePoint now) { is_over_ = sent_at_ && *sent_at_ <= now; }
  /// Since the last `clear_dropped` or `reset`; packets.
  std::uint32_t dropped() const { return dropped_; }
  void clear_dropped() { dropped_ = 0; }
  void reset() { *this = TransmitBuffer(octet_time_); }

 private:
  static std::size_t room_of(const Bytes& packet);
  Duration time_of(const Bytes& packet) const;

  Duration octet_time_;
  std::deque<Bytes> packets_;
  std::size_t octets_ = 0;
  std::optional<TimePoint> sent_at_;  ///< when the first packet has gone over the line
  bool is_over_ = false;              ///< it has, but nobody has taken it
  std::uint32_t dropped_ = 0;
};

}  // namespace slamgw::sim::ble
