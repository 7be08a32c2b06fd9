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
#include <string_view>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

// Consistent Overhead Byte Stuffing: frames without zero octets, so that a zero ends each of them.
// Unlike Nordic's framing it finds its own borders again. Called by CobsMesh.

/// Without the zero that ends it on the wire.
Bytes encode_cobs(ByteView data);
Result<Bytes, DecodeError> decode_cobs(ByteView encoded);

/// Cuts a stream at its zeros.
class CobsSplitter {
 public:
  /// Robots send at most 50 octets; anything much longer is no frame of theirs.
  static constexpr std::size_t max_frame = 512;

  /// The encoded frames that `bytes` completes, never empty. What comes before the first zero is
  /// the end of a frame whose start was missed, and is dropped.
  std::vector<Bytes> on_bytes(ByteView bytes);
  /// The port was opened again: what was read of an unfinished frame is dropped.
  void reset();
  /// Frames dropped for their length since the splitter was made.
  std::uint64_t oversize() const { return oversize_; }

 private:
  Bytes partial_;
  bool is_skipping_ = true;  ///< until the next zero
  std::uint64_t oversize_ = 0;
};

// The frame of the older robots (Lien 2017): `dst src protocol data.. crc`, COBS-coded, ended by a
// zero. The server has address 0, robots 1 and up. Called by CobsMesh.

inline constexpr std::uint8_t lien_server_address = 0;

enum class LienProtocol : std::uint8_t {
  simple = 0,  ///< sent once
  arq = 1,     ///< acknowledged, see lien_connection.hpp
};

struct LienFrame {
  std::uint8_t destination = 0;
  std::uint8_t source = 0;
  LienProtocol protocol = LienProtocol::simple;
  Bytes data;
  bool operator==(const LienFrame&) const = default;
};

/// CRC-8/MAXIM: polynomial x^8+x^5+x^4+1 reflected (0x8c), start value 0.
std::uint8_t crc8_maxim(ByteView bytes);

/// As it goes over the wire, coded and ended.
Bytes encode_lien_frame(const LienFrame& frame);
/// `raw` is COBS-decoded already.
Result<LienFrame, DecodeError> decode_lien_frame(ByteView raw);

/// The name of a message by its first octet, for the topic's type; nothing for those that only the
/// server sends and for unused numbers.
std::optional<std::string_view> lien_type_name(std::uint8_t message_type);
inline constexpr std::uint8_t lien_update_message = 1;

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
