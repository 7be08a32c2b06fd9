// SPDX-License-Identifier: Apache-2.0
// The mesh behind a board that only streams COBS frames. They are the thesis's positions, which
// carry no source and belong to one configured robot, or the older robots' frames with an address
// (LienFrame). No robot on such a link can be commanded. Called by CobsAdapter.
#pragma once

#include <array>
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

// Consistent Overhead Byte Stuffing: frames have no zero octets, and a zero ends each frame. After
// a loss a reader finds the frame borders again, unlike with Nordic's framing. Called by CobsMesh.

/// Returns the frame without the zero that ends it on the wire.
Bytes encode_cobs(ByteView data);
Result<Bytes, DecodeError> decode_cobs(ByteView encoded);

/// Cuts a stream into frames at its zeros.
class CobsSplitter {
 public:
  /// Robots send at most 50 octets; a much longer frame is not from a robot.
  static constexpr std::size_t max_frame = 512;

  /// Returns the encoded frames that `bytes` completes; no frame is empty. Drops the octets before
  /// the first zero: they end a frame whose start was missed.
  std::vector<Bytes> on_bytes(ByteView bytes);
  /// Drops an unfinished frame. Call when the port was opened again.
  void reset();
  /// Returns the number of frames that were dropped for their length since the splitter was made.
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

/// Returns the frame as it is sent: COBS-coded, with a zero at its end.
Bytes encode_lien_frame(const LienFrame& frame);
/// `raw` must be COBS-decoded already.
Result<LienFrame, DecodeError> decode_lien_frame(ByteView raw);

/// Returns the topic's type for messages with this first octet; nothing for unused numbers and for
/// messages that only the server sends.
std::optional<std::string_view> lien_type_name(std::uint8_t message_type);
inline constexpr std::uint8_t lien_update_message = 1;

/// Assembles the messages of one older robot from its frames, in two ways. "Simple" messages come
/// in parts, each sent once. ARQ is a connection with numbered segments, each acknowledged with the
/// next number expected. A message that came by ARQ is acknowledged only when it is safe. The
/// segment that completes it stays unanswered until then, and the robot sends it again each 200 ms.
/// Called by CobsMesh.
///
/// ARQ:    robot SYN -> SYNACK -> ACK 0, then DATA n -> ACK n+1 (7-bit numbers).
/// Simple: `part last_part message..`, parts from 0.
class LienConnection {
 public:
  /// The longest of the robots' messages is a handshake with a name, below 100 octets.
  static constexpr std::size_t max_message = 512;

  /// Returns the message that `data` completes, if any, type octet first.
  std::optional<Bytes> on_simple(ByteView data);

  struct ArqOutcome {
    std::optional<Bytes> reply = {};    ///< data of an ARQ frame for the robot
    std::optional<Bytes> message = {};  ///< complete; call on_safe or on_refused next
    bool is_new_connection = false;     ///< an open message is void
  };
  ArqOutcome on_arq(ByteView data);
  /// The last message is safe. Returns the reply to send.
  Bytes on_safe();
  /// The last message was not taken: the robot's next copy counts as new.
  void on_refused();

 private:
  enum class Segment : std::uint8_t { data = 0, ack = 1, syn = 2, synack = 3, alive_test = 4 };

  ArqOutcome on_segment(std::uint8_t number, ByteView payload);
  std::optional<Bytes> complete_message() const;
  Bytes acknowledge() const;

  Bytes parts_;  ///< of a simple message
  std::uint8_t next_part_ = 0;

  bool is_connected_ = false;
  bool is_open_ = false;           ///< a complete message is not safe yet
  std::uint8_t expected_ = 0;      ///< 7 bits
  Bytes stream_;                   ///< `length:2 message..` so far
  std::size_t stream_before_ = 0;  ///< size of `stream_` before the segment that completed it
};

using CobsAction = std::variant<WriteSerial, MeshEvent>;

class CobsMesh {
 public:
  /// With positions, `settings.robot_id` must be set when the mesh is started.
  CobsMesh(Settings settings, TopicScheme topics, RobotNames names);

  void on_start();
  void on_port_open(TimePoint now);
  void on_port_closed(const std::string& why, TimePoint now);
  void on_bytes(ByteView bytes, TimePoint now);
  /// Renames older robots; with positions, the only robot's name is a setting. Banned robots go
  /// offline.
  void on_names(RobotNames names, TimePoint now);

  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  /// Ends the command as "refused" if its robot is on this link.
  void on_broker_message(const RobotMessage& message, TimePoint now);
  void on_subscribe_result(const std::string& robot, const std::string& filter, bool granted,
                           TimePoint now);
  /// See MeshAdapter. Returns nothing, because no command waits.
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
  /// A publication of a message that came by ARQ: whole, or as `update`. When one is refused, the
  /// robot repeats the message. The one that is safe is not published again.
  struct Part {
    std::uint64_t receipt = 0;  ///< 0: none is open
    std::optional<ReceiptOutcome> outcome = {};
  };
  /// A robot. Its key in `peers_` is its Lien address, at most 255; with positions there is only
  /// one.
  struct Peer {
    std::string id;
    std::string address;  ///< as operators see it
    bool is_online = false;
    TimePoint last_heard{};
    bool is_subscribed = true;  ///< false: the broker refused; asked again later
    LienConnection connection = {};
    std::array<Part, 2> open = {};  ///< the open message: the whole, and its `update`
  };

  void on_frame(const Bytes& encoded, TimePoint now);
  void on_lien_frame(const LienFrame& frame, TimePoint now);
  /// `parts`: as in Peer::open; null for a message that is not acknowledged.
  void on_lien_message(const Peer& peer, ByteView message, Part* parts);
  void add_configured(bool is_start);
  void rename_peers();
  Peer& lien_peer(std::uint8_t address);
  void on_heard(Peer& peer, TimePoint now);
  void reply(std::uint8_t address, const Bytes& data);
  void report(const Peer& peer, std::string_view type, ByteView payload, Part* part);
  void reject(std::string_view why, TimePoint now);
  /// `is_here`: the request counts as a sign that the robot is here, and not at another gateway.
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
  std::uint64_t last_receipt_ = 0;
  std::uint64_t reports_ = 0;
  std::uint64_t rejected_ = 0;
  LogThrottle reject_throttle_;
};

}  // namespace slamgw::ble
