// SPDX-License-Identifier: Apache-2.0
// The board's buffer towards its host. What does not fit is dropped, which only command 0x14 tells.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/bytes.hpp"

namespace slamgw::sim::ble {

class TransmitBuffer {
 public:
  static constexpr std::size_t capacity = 2 * 256;  ///< octets

  /// Puts the length octet in front.
  void push(const Bytes& opcode_and_params);
  std::optional<Bytes> pop();
  /// Since the last `clear_dropped` or `reset`; packets.
  std::uint32_t dropped() const { return dropped_; }
  void clear_dropped() { dropped_ = 0; }
  void reset() { *this = TransmitBuffer(); }

 private:
  std::deque<Bytes> packets_;
  std::size_t octets_ = 0;
  std::uint32_t dropped_ = 0;
};

}  // namespace slamgw::sim::ble
