// SPDX-License-Identifier: Apache-2.0
// The board's buffer for its host. Packets that do not fit are dropped, which only command 0x14
// reports.
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

  /// Sets the time of an octet on the line; 0: no time.
  explicit TransmitBuffer(Duration octet_time) : octet_time_(octet_time) {}

  /// Adds a packet, with its length octet in front.
  void push(const Bytes& opcode_and_params);
  /// Returns the first packet once it has passed the line. Until then it occupies the buffer.
  std::optional<Bytes> pop(TimePoint now);
  /// Returns when `pop` has the next packet; nothing if it has one now.
  std::optional<TimePoint> deadline() const { return is_over_ ? std::nullopt : sent_at_; }
  void on_deadline(TimePoint now) { is_over_ = sent_at_ && *sent_at_ <= now; }
  /// Returns the number of packets dropped since the last `clear_dropped` or `reset`.
  std::uint32_t dropped() const { return dropped_; }
  void clear_dropped() { dropped_ = 0; }
  void reset() { *this = TransmitBuffer(octet_time_); }

 private:
  static std::size_t room_of(const Bytes& packet);
  Duration time_of(const Bytes& packet) const;

  Duration octet_time_;
  std::deque<Bytes> packets_;
  std::size_t octets_ = 0;
  std::optional<TimePoint> sent_at_;  ///< when the first packet has passed the line
  bool is_over_ = false;              ///< it has passed, but was not popped
  std::uint32_t dropped_ = 0;
};

}  // namespace slamgw::sim::ble
