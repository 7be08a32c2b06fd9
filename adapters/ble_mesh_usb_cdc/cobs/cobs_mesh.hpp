// SPDX-License-Identifier: Apache-2.0
// Boards that only stream COBS frames: the thesis's positions, which carry no source and belong to
// one configured robot, or the older robots' frames with an address (LienFrame). There is no
// way to command a robot on such a link. Called by CobsAdapter.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/result.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

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
  arq = 1,     ///< acknowledged, see LienConnection
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

/// Messages from one older robot, put together from its frames. Two ways: "simple" (parts, sent
/// once) and ARQ (a connection, numbered segments, each acknowledged with the next number
/// expected). A message that came by ARQ is acknowledged only when it is safe: the segment that
/// completes it stays unanswered until then, and the robot sends it again each 200 ms. Called by
/// CobsMesh.
///
/// ARQ:    robot SYN -> SYNACK -> ACK 0, then DATA n -> ACK n+1 (7-bit numbers).
/// Simple: `part last_part message..`, parts from 0.
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

using CobsAction = std::variant<WriteSerial, MeshEvent>;

class CobsMesh {
 public:
  /// With positions `settings.robot_id` is set.
  CobsMesh(Settings settings, TopicScheme topics, RobotNames names);

  void on_start();
  void on_port_open(TimePoint now);
  void on_port_closed(const std::string& why, TimePoint now);
  void on_bytes(ByteView bytes, TimePoint now);
  /// With positions the one robot's name is a setting.
  void on_names(RobotNames names, TimePoint now);

  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  /// Answered with the outcome "refused" when the robot is on this link.
  void on_broker_message(const RobotMessage& message, TimePoint now);
  void on_subscribe_result(const std::string& robot, const std::string& filter, bool granted,
                           TimePoint now);
  /// As MeshAdapter; no command waits.
  std::vector<WaitingMessage> give_up(const std::string& robot, TimePoint now);
  void on_broker_link(bool is_up, TimePoint now);
  void on_trace(bool) {}      // no command is sent, and acknowledgements are not traced here
  void on_stop(TimePoint) {}  // no command waits

  std::optional<CobsAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  std::optional<Presence> presence_of(std::string_view robot) const;
  std::size_t queued_for(std::string_view) const { return 0; }
  Counters counters() const;

 private:
  /// A robot. Keyed by its Lien address, of which there are 255; with positions there is one.
  struct Peer {
    std::string id;
    std::string address;  ///< for people
    bool is_online = false;
    TimePoint last_heard{};
    bool is_subscribed = true;  ///< false: the broker refused it; asked again later
    LienConnection connection = {};
    std::uint64_t open_receipt = 0;  ///< 0: none
  };

  void on_frame(const Bytes& encoded, TimePoint now);
  void on_lien_frame(const LienFrame& frame, TimePoint now);
  void on_lien_message(Peer& peer, ByteView message, std::uint64_t receipt_id);
  void add_configured(bool is_start);
  Peer& lien_peer(std::uint8_t address);
  void on_heard(Peer& peer, TimePoint now);
  void reply(std::uint8_t address, const Bytes& data);
  void report(const Peer& peer, std::string_view type, ByteView payload, std::uint64_t receipt_id);
  void reject(std::string_view why, TimePoint now);
  /// `is_here`: counts as a sign that the robot is here, and not at another gateway.
  void subscribe(const Peer& peer, bool is_here);
  void emit(MeshEvent event) { actions_.push(std::move(event)); }

  Settings settings_;
  TopicScheme topics_;
  RobotNames names_;
  ActionQueue<CobsAction> actions_;
  CobsSplitter splitter_;
  bool is_up_ = false;
  std::string down_reason_;
  std::map<std::uint8_t, Peer> peers_;
  std::map<std::uint64_t, std::uint8_t> open_receipts_;  ///< at most one for each peer
  std::uint64_t last_receipt_ = 0;
  std::uint64_t reports_ = 0;
  std::uint64_t rejected_ = 0;
  LogThrottle reject_throttle_;
};

}  // namespace slamgw::ble
