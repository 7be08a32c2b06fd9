// SPDX-License-Identifier: Apache-2.0
// What travels between the meshes, the core and the broker: plain values. The receipt
// (ARCHITECTURE.md, "The receipt") is the handle of the acknowledgement that a mesh owes a robot;
// nothing is acknowledged before its receipt has fired.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "daemon/core/audit.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/mesh.hpp"
#include "daemon/core/time.hpp"

namespace slamgw {

/// MQTT's levels of delivery. MQTT-SN's "QoS -1" comes up as at_most_once.
enum class Qos : std::uint8_t { at_most_once = 0, at_least_once = 1, exactly_once = 2 };

/// The acknowledgement owed for one message. `id` is chosen by the mesh's machine, unique within
/// that mesh for the life of the process; 0 means that nobody waits for an acknowledgement, and
/// then the mesh does not matter.
struct Receipt {
  RequiredMesh mesh;
  std::uint64_t id = 0;
  bool is_owed() const { return id != 0; }
  bool operator==(const Receipt&) const = default;
};
inline constexpr Receipt no_receipt{Mesh::thread, 0};

/// How a receipt fires. `refused`: there is no room; the robot must not be acknowledged and keeps
/// its message.
enum class ReceiptOutcome : std::uint8_t { safe, refused };

struct FireReceipt {
  Receipt receipt;
  ReceiptOutcome outcome = ReceiptOutcome::safe;
};

/// Why the broker does not take a message.
struct Refusal {
  int code = 0;     ///< MQTT 5 reason code, 0x80 and up; 0: the broker closes the connection
  std::string why;  ///< for people: "not authorised"

  /// The message itself is at fault: no change of rights or quotas will make it acceptable.
  bool is_permanent() const {
    constexpr int topic_name_invalid = 0x90;
    constexpr int packet_too_large = 0x95;
    constexpr int payload_format_invalid = 0x99;
    return code == topic_name_invalid || code == packet_too_large || code == payload_format_invalid;
  }
};

/// What a mesh knows about the path of a message; nothing where its radio does not tell it.
struct RadioFacts {
  std::optional<int> rssi_dbm;       ///< of the last hop
  std::optional<std::uint8_t> hops;  ///< relays on the way
  std::optional<std::uint8_t> ttl;   ///< on arrival
};

/// What a mesh's protocol says about one message besides its content; nothing where it has no such
/// field.
struct WireFacts {
  std::optional<std::uint16_t> message_id{};
  std::optional<bool> is_dup{};  ///< its sender marked it as a repeat
};

/// Up: what a robot said. `topic` is the full topic name (`<prefix>/robot/<robot>/<type>`, or one
/// that `topics.extra_publish` allows); the mesh's machine has already made sure that this robot
/// may use it.
struct Report {
  RequiredMesh mesh;
  std::string robot;
  std::string topic;
  Bytes payload;
  Qos qos = Qos::at_most_once;
  bool retain = false;
  Receipt receipt;
  bool is_will = false;  ///< a last will: no sign of life
  std::optional<RadioFacts> radio = {};
  WireFacts wire = {};
  /// Its client has shown that it receives, or its mesh knows the robot by a key. Strangers without
  /// number cannot do that, so lines of the log about them have a budget of their own.
  bool is_proven = true;
};

/// Where a robot's message came from; published as MQTT 5 user properties.
struct Provenance {
  RequiredMesh mesh;
  WallTime received_at{};
};

/// Milliseconds in 32 bits: messages are copied into many queues.
using Waited = std::chrono::duration<std::uint32_t, std::milli>;

/// An MQTT message, in either direction.
struct BrokerMessage {
  std::string topic;
  Bytes payload;
  Qos qos = Qos::at_most_once;
  bool retain = false;
  std::optional<Provenance> provenance{};  ///< of a robot's message on its way up
  /// For how long a command has waited in the gateway before it is carried out. It counts of the
  /// 30 s in which it has an outcome.
  Waited waited{};
  Sender sender{};  ///< of a command
};

enum class Presence : std::uint8_t { online, asleep, offline };
std::string_view to_string(Presence presence);

/// A robot's new presence on one mesh. `address` is for people: `[fd00::1]:47193`, `0x0100`.
struct PresenceChange {
  RequiredMesh mesh;
  std::string robot;
  Presence presence = Presence::online;
  std::string address;
  bool is_deaf = false;       ///< it is online, and does not hear the gateway
  bool is_contested = false;  ///< another client uses its id
  bool is_proven = true;      ///< see Report
};

/// A robot was heard, by whatever message (an acknowledgement, a ping): at most once a second.
struct SignOfLife {
  RequiredMesh mesh;
  std::string robot;
};

/// A robot wants broker messages that match `filter`, on the robot's own session at the broker
/// (daemon/sessions). Answered once by MeshAdapter::on_subscribe_result(): by the broker, or by the
/// gateway at once while the broker is away; it asks as soon as the session is there. Retained
/// messages come for this robot only, and marked.
struct SubscribeRequest {
  RequiredMesh mesh;
  std::string robot;
  std::string filter;
  Qos qos = Qos::at_most_once;
  /// The robot had it before (its session goes on after a restart, or comes from another gateway):
  /// not answered; the broker is asked only if it has forgotten it, and then without its retained
  /// messages.
  bool is_standing = false;
};
struct UnsubscribeRequest {
  RequiredMesh mesh;
  std::string robot;
  std::string filter;
};
/// The robot begins anew (CleanSession): nothing of its former session at the broker counts.
struct SessionCleaned {
  RequiredMesh mesh;
  std::string robot;
};
/// The mesh ended the session of a robot that is offline, to make room: nothing is kept of it.
struct SessionEvicted {
  RequiredMesh mesh;
  std::string robot;
};
/// What another gateway needs to go on with the robot's session there; kept at the broker,
/// retained. Empty when there is nothing to go on with.
struct NoteChanged {
  RequiredMesh mesh;
  std::string robot;
  Bytes note;
};
/// The robot has come, perhaps from another gateway. Answered once by MeshAdapter::on_note().
struct NoteRequest {
  RequiredMesh mesh;
  std::string robot;
};

/// Names one command (a message under `<prefix>/server/<robot>/<type>`) from its entry to its
/// outcome. Given by the core, unique for the life of the process. `none`: no command, or one from
/// before a restart.
enum class CommandId : std::uint64_t { none = 0 };

/// A broker message for one robot, as its session brought it.
struct RobotMessage {
  std::string robot;
  BrokerMessage message;
  /// With one, the mesh carries it and owes its CommandOutcome within 30 s, less what it has
  /// waited; only a retained command for which the robot does not wait may end without one.
  CommandId command = CommandId::none;
  /// No subscription of the robot brought it, as far as the broker says (MQTT 5).
  bool is_unasked = false;
};
/// What a mesh has for a robot and has not put on the air. `message.waited` says for how long.
struct WaitingMessage {
  BrokerMessage message;
  CommandId command = CommandId::none;
};

/// `sent`: at QoS 0; nobody acknowledges it.
enum class CommandResult : std::uint8_t { delivered, sent, timeout, refused, superseded };
inline constexpr std::size_t command_result_count = 5;
std::string_view to_string(CommandResult result);

/// Down: how one command ended. Exactly one for each command.
struct CommandOutcome {
  std::optional<Mesh> mesh;  ///< nothing when no mesh has carried it
  CommandId id = CommandId::none;
  std::string robot;
  std::string type;
  CommandResult result = CommandResult::delivered;
  std::chrono::milliseconds after{0};
  std::string why;  ///< empty when delivered or sent
};

/// What a mesh did with one message, besides reporting it or the outcome of a command. `repeat`: a
/// robot's message came again and was not published again; always reported. The others are reported
/// only while an operator watches (MeshAdapter::trace): `acknowledged`: the robot got its
/// acknowledgement; `refused`: its message was not taken; `sent`: a message was handed to the
/// radio, once more if `wire.is_dup`.
struct MeshStep {
  enum class Kind : std::uint8_t { repeat, acknowledged, refused, sent };
  Kind kind = Kind::repeat;
  RequiredMesh mesh;
  std::string robot;
  std::string address{};  ///< of `sent` to a group: that group; empty: the robot's
  std::string topic{};    ///< empty: that of the receipt or the command, or not known
  std::optional<Qos> qos{};
  WireFacts wire{};
  std::optional<std::size_t> bytes{};  ///< of the payload
  std::optional<RadioFacts> radio{};
  Receipt receipt = no_receipt;         ///< of `acknowledged` and `refused`, where it had one
  CommandId command = CommandId::none;  ///< of `sent`, when it is one
  std::string why{};                    ///< why it was refused
};

/// The mesh's own link (the serial board, the UDP sockets) came up or went down; `detail` is for
/// `status` and the log.
struct LinkChange {
  RequiredMesh mesh;
  bool is_up = false;
  std::string detail;
};

enum class Severity : std::uint8_t { debug, info, notice, warning, error };
/// Superseded is normal; no warning.
Severity severity_of(CommandResult result);

/// The kind of a log line, to search for it by the journal's MESSAGE_ID.
enum class Occasion : std::uint8_t {
  other,
  robot_message,  ///< traffic, in either direction
  robot_presence,
  command_outcome,
  rejected_payload,
  mesh_link,
  broker_link,
};

/// Something an operator should read. Pure code makes the text, shells write it. Never holds keys,
/// passwords or OOB data.
struct Notice {
  Severity severity = Severity::info;
  std::string text;
  std::string robot;  ///< may be empty
  Occasion occasion = Occasion::other;
  std::optional<std::chrono::microseconds> latency{};  ///< of a command, where known
  bool is_proven = true;                               ///< see Report
  std::optional<AuditFacts> audit{};                   ///< the line is one of the audit trail
};

/// What a mesh's machine reports to the core.
using MeshEvent = std::variant<Report, PresenceChange, SignOfLife, SubscribeRequest,
                               UnsubscribeRequest, SessionCleaned, SessionEvicted, NoteChanged,
                               NoteRequest, CommandOutcome, LinkChange, MeshStep, Notice>;

/// A named counter for `stats` and `slam-gatewayctl status`; names are snake_case and stable.
struct Counter {
  std::string_view name;
  std::uint64_t value = 0;
};
using Counters = std::vector<Counter>;

/// The places that a mesh has for clients, and who takes them; for operators.
struct MeshPlaces {
  /// An address or a network, and how many clients it has; empty when there are none.
  struct Crowd {
    std::string address;
    std::uint64_t clients = 0;
  };
  std::uint64_t max = 0;
  std::uint64_t taken = 0;
  Crowd most;                  ///< of all
  std::uint64_t unproven = 0;  ///< of these, by clients that are not proven (Report::is_proven)
  Crowd most_unproven;         ///< of those
};

}  // namespace slamgw
