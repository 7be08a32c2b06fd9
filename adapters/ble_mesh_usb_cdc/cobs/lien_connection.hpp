// SPDX-License-Identifier: Apache-2.0
// Messages from one older robot, put together from its frames. Two ways: "simple" (parts, sent
// once) and ARQ (a connection, numbered segments, each acknowledged with the next number expected).
// A message that came by ARQ is acknowledged only when it is safe: the segment that completes it
// stays unanswered until then, and the robot sends it again each 200 ms. Called by CobsMesh.
//
// ARQ:    robot SYN -> SYNACK -> ACK 0, then DATA n -> ACK n+1 (7-bit numbers).
// Simple: `part last_part message..`, parts from 0.
#pragma once

#include <cstdint>
#include <optional>

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

class LienConnection {
 public:
  /// The longest of the robots' messages is a handshake with a name, below 100 octets.
  static constexpr std::size_t max_message = 512;

  /// The message that this completes, type octet first.
  std::optional<Bytes> on_simple(ByteView data);

  struct ArqOutcome {
    std::optional<Bytes> reply = {};    ///< data of an ARQ frame for the robot
    std::optional<Bytes> message = {};  ///< complete; to be followed by on_safe or on_refused
    bool is_new_connection = false;     ///< an open message is void
  };
  ArqOutcome on_arq(ByteView data);
  /// The last message is safe; the reply to send.
  Bytes on_safe();
  /// It was not taken: the robot's next copy counts again.
  void on_refused();

 private:
  enum class Segment : std::uint8_t { data = 0, ack = 1, syn = 2, synack = 3, alive_test = 4 };

  ArqOutcome on_segment(std::uint8_t number, ByteView payload);
  std::optional<Bytes> complete_message() const;
  Bytes acknowledge() const;

  Bytes parts_;  ///< of a simple message
  std::uint8_t next_part_ = 0;

  bool is_connected_ = false;
  bool is_open_ = false;           ///< a complete message waits to be safe
  std::uint8_t expected_ = 0;      ///< 7 bits
  Bytes stream_;                   ///< `length:2 message..` so far
  std::size_t stream_before_ = 0;  ///< its size before the segment that completed it
};

}  // namespace slamgw::ble
