// SPDX-License-Identifier: Apache-2.0
// The values that travel between the meshes, the core and the broker. The receipt (ARCHITECTURE.md,
// "The receipt") is the handle of the acknowledgement that a mesh owes a robot; nothing is
// acknowledged before its receipt has fired.
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
/// that mesh for the life of the process. With id 0 no acknowledgement is owed, and the mesh does
/// not matter.
struct Receipt {
  RequiredMesh mesh;
  std::uint64_t id = 0;
  bool is_owed() const { return id != 0; }
  bool operator==(const Receipt&) const = default;
};
inline constexpr Receipt no_receipt{Mesh::thread, 0};

/// How a receipt fires. `refused`: the gateway has no room for the message; the mesh must not
/// acknowledge it, and the robot keeps it.
enum class ReceiptOutcome : std::uint8_t { safe, refused };

struct FireReceipt {
  Receipt receipt;
  ReceiptOutcome outcome = ReceiptOutcome::safe;
};

/// Why the broker refuses a message.
struct Refusal {
  int code = 0;     ///< MQTT 5 reason code, 0x80 and up; 0: the broker closes the connection
  std::string why;  ///< for people: "not authorised"

  /// True when the message itself is at fault: no change of rights or quotas will make it
  /// acceptable.
  bool is_permanent() const {
    constexpr int topic_name_invalid = 0x90;
    constexpr int packet_too_large = 0x95;
    constexpr int payload_format_invalid = 0x99;
    return code == topic_name_invalid || code == packet_too_large || code == payload_format_invalid;
  }
};

/// The path of a message, as far as the mesh's radio reports it.
struct RadioFacts {
  std::optional<int> rssi_dbm;       ///< of the last hop
  std::optional<std::uint8_t> hops;  ///< relays on the way
  std::optional<std::uint8_t> ttl;   ///< on arrival
};

/// Protocol fields of one message besides its content; nothing where the protocol has no such
/// field.
struct WireFacts {
  std::optional<std::uint16_t> message_id{};
  std::optional<bool> is_dup{};  ///< its sender marked it as a repeat
};

/// Up: a message from a robot. `topic` is the full topic name (`<prefix>/robot/<robot>/<type>`, or
/// one that `topics.extra_publish` allows); the mesh's machine has already made sure that this
/// robot may use it.
struct Report {
  RequiredMesh mesh;
  std::string robot;
  std::string topic;
  Bytes payload;
  Qos qos = Qos::at_most_once;
  bool retain = false;
  Receipt receipt;
  bool is_will = false;  ///< a last will, so not a sign of life
  std::optional<RadioFacts> radio = {};
  WireFacts wire = {};
  std::string address{};  ///< of a sender that is not connected as `robot`; else empty
  /// The client has shown that it receives, or the mesh knows the robot by a key. Strangers can't
  /// do either, however many there are, so log lines about them have their own budget.
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
  /// How long a command has waited in the gateway. This time is part of the 30 s in which the
  /// command has an outcome.
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
  bool is_deaf = false;       ///< the robot is online but does not hear the gateway
  bool is_contested = false;  ///< another client uses the robot's id
  bool is_proven = true;      ///< see Report
};

/// A robot was heard, by any message (an acknowledgement, a ping). Reported at most once a second.
struct SignOfLife {
  RequiredMesh mesh;
  std::string robot;
};

/// A robot wants broker messages that match `filter`, on the robot's own session at the broker
/// (daemon/sessions). Answered once by MeshAdapter::on_subscribe_result() with the broker's answer.
/// While the broker is offline, the gateway answers at once and subscribes as soon as the session
/// is there. Retained messages come to this robot only, with their retain flag.
struct SubscribeRequest {
  RequiredMesh mesh;
  std::string robot;
  std::string filter;
  Qos qos = Qos::at_most_once;
  /// The robot already had this subscription: its session continues after a restart or from another
  /// gateway. The request is not answered. The broker is asked only if it has forgotten the
  /// subscription, and then without its retained messages.
  bool is_standing = false;
};
struct UnsubscribeRequest {
  RequiredMesh mesh;
  std::string robot;
  std::string filter;
};
/// The robot begins a clean session (CleanSession): its former session at the broker is void.
struct SessionCleaned {
  RequiredMesh mesh;
  std::string robot;
};
/// The mesh ended the session of a robot that is offline, to make room, and keeps nothing of it.
struct SessionEvicted {
  RequiredMesh mesh;
  std::string robot;
};
/// The note from which another gateway continues the robot's session; the broker retains it. Empty
/// when there is nothing to continue.
struct NoteChanged {
  RequiredMesh mesh;
  std::string robot;
  Bytes note;
};
/// Asks for the note of a robot that has come, perhaps from another gateway. Answered once by
/// MeshAdapter::on_note().
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
  /// With a command id, the mesh carries the command and owes its CommandOutcome within 30 s, less
  /// `message.waited`. Only a retained command for which the robot does not wait may end without
  /// one.
  CommandId command = CommandId::none;
  /// As far as the broker says (MQTT 5), no subscription of the robot brought this message.
  bool is_unasked = false;
};
/// A message that a mesh has for a robot and has not put on the air. `message.waited` says how
/// long.
struct WaitingMessage {
  BrokerMessage message;
  CommandId command = CommandId::none;
};

/// `sent`: at QoS 0, so without an acknowledgement.
enum class CommandResult : std::uint8_t { delivered, sent, timeout, refused, superseded };
inline constexpr std::size_t command_result_count = 5;
std::string_view to_string(CommandResult result);

/// Down: how one command ended. Each command has exactly one outcome.
struct CommandOutcome {
  std::optional<Mesh> mesh;  ///< nothing when no mesh has carried it
  CommandId id = CommandId::none;
  std::string robot;
  std::string type;
  CommandResult result = CommandResult::delivered;
  std::chrono::milliseconds after{0};
  std::string why;  ///< empty when delivered or sent
};

enum class StepKind : std::uint8_t {
  arrived,       ///< a robot's message came
  repeat,        ///< a robot's message came again and was not published again
  stored,        ///< the disk has the message
  published,     ///< the broker has the message; at QoS 0: it was handed to the network
  acknowledged,  ///< the robot got its acknowledgement
  refused,       ///< by the gateway or by the broker
  command,       ///< a message to a robot came from the broker or an operator
  sent,          ///< a message was handed to the radio, once more if `wire.is_dup`
  outcome,       ///< how a command ended
};
/// Returns the kind's name in the JSON.
std::string_view to_string(StepKind kind);
/// Returns true for the steps of a message to robots.
constexpr bool is_down(StepKind kind) {
  return kind == StepKind::command || kind == StepKind::sent || kind == StepKind::outcome;
}

/// One step of one message. A mesh reports `repeat` always; `acknowledged`, `refused` and `sent`
/// only while an operator watches (MeshAdapter::trace). The outbox reports `stored`, `published`
/// and `refused` of robots' messages while an operator watches. Trace makes the other kinds.
struct MessageStep {
  StepKind kind = StepKind::arrived;
  std::optional<Mesh> mesh;  ///< nothing for a command to a robot that is known on no mesh
  std::string robot{};       ///< empty for a step of the outbox
  std::string address{};  ///< of the robot on `mesh`, or of a group; empty: the robot's, or unknown
  std::string topic{};    ///< empty: the topic of the receipt or the command, or not known
  std::optional<Qos> qos{};
  WireFacts wire{};
  std::optional<std::size_t> bytes{};  ///< of the payload
  std::optional<RadioFacts> radio{};
  Receipt receipt = no_receipt;         ///< on its way up; may be none, or may have fired already
  CommandId command = CommandId::none;  ///< on its way down, when the message is a command
  std::string why{};  ///< of `refused`, `outcome`, `arrived` (under rejected/); may be empty
  std::optional<TimePoint> since{};  ///< of a step of the outbox: when it got the message
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
  broker_refusal,  ///< of messages; the journal has no MESSAGE_ID for it
};

/// A log line for operators. Pure code makes the text, shells write it. Never holds keys, passwords
/// or OOB data.
struct Notice {
  Severity severity = Severity::info;
  std::string text;
  std::string robot;  ///< may be empty
  Occasion occasion = Occasion::other;
  std::optional<std::chrono::microseconds> latency{};  ///< of a command, where known
  bool is_proven = true;                               ///< see Report
  std::optional<AuditFacts> audit{};                   ///< set for a line of the audit trail
  std::optional<Mesh> mesh{};  ///< of the robot's message, command or presence, where known
  std::string type{};          ///< of the robot's message or command; may be empty
};

/// An event that a mesh's machine reports to the core.
using MeshEvent = std::variant<Report, PresenceChange, SignOfLife, SubscribeRequest,
                               UnsubscribeRequest, SessionCleaned, SessionEvicted, NoteChanged,
                               NoteRequest, CommandOutcome, LinkChange, MessageStep, Notice>;

/// A named counter for `stats` and `slam-gatewayctl status`; names are snake_case and stable.
struct Counter {
  std::string_view name;
  std::uint64_t value = 0;
};
using Counters = std::vector<Counter>;

/// The places that a mesh has for clients, and the clients that take most; for operators.
struct MeshPlaces {
  /// An address or a network, and its number of clients; the address is empty when there are none.
  struct Crowd {
    std::string address;
    std::uint64_t clients = 0;
  };
  std::uint64_t max = 0;
  std::uint64_t taken = 0;
  Crowd most;                  ///< of all clients
  std::uint64_t unproven = 0;  ///< places taken by unproven clients (Report::is_proven)
  Crowd most_unproven;         ///< of the unproven clients
};

}  // namespace slamgw
