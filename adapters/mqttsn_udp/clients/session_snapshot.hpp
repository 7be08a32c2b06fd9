// SPDX-License-Identifier: Apache-2.0
// The part of a session that survives a restart of the daemon (R47; docs/topics.md, promise 7), as
// values that a store can write. Acknowledgements owed for messages that were not safe yet are left
// out: the robot repeats these messages.
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_session.hpp"

namespace slamgw::mqttsn {

struct SubscriptionSnapshot {
  std::string filter;
  Qos qos = Qos::at_most_once;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t topic_id = 0;
};

/// An undelivered QoS 1 or 2 message. The message that awaits its acknowledgement comes first.
struct MessageSnapshot {
  BrokerMessage message;
  Qos qos = Qos::at_least_once;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t predefined_id = 0;
  std::uint16_t msg_id = 0;  ///< not 0: it was sent under this id
  /// For a command without an outcome: how long it has waited.
  std::optional<std::chrono::milliseconds> command_age{};
};

/// A recently acknowledged message: its repetition is acknowledged again and not reported (R76).
struct RepeatSnapshot {
  std::uint16_t msg_id = 0;
  std::uint16_t topic_id = 0;
  std::uint64_t fingerprint = 0;
  std::chrono::milliseconds age{0};  ///< when the snapshot was taken
};

struct SessionSnapshot : SessionTerms {
  std::string client_id;
  std::string robot;
  ClientState state = ClientState::disconnected;  ///< never awake
  std::optional<Peer> peer;
  bool is_validated = true;     ///< its address has shown that it receives
  std::uint32_t allowance = 0;  ///< if not: octets that may be sent there
  bool has_answered = false;
  std::optional<Will> will;
  std::vector<TopicTable::Topic> topics;
  std::vector<SubscriptionSnapshot> subscriptions;
  std::vector<MessageSnapshot> messages;
  std::vector<std::uint16_t> released;   ///< MsgIds of QoS 2: PUBREC came, PUBREL is due
  std::vector<std::uint16_t> abandoned;  ///< MsgIds of failed QoS 2 commands: no PUBREL is due
  std::vector<std::pair<std::uint16_t, std::uint64_t>> inbound_qos2;  ///< MsgId, fingerprint
  std::vector<RepeatSnapshot> repeats;                                ///< oldest first
  bool counts_ids = false;                                            ///< see RepeatFilter
  std::uint16_t last_msg_id = 0;
  /// When the snapshot was taken. The clock goes on over a restart of the daemon, not of the host.
  std::optional<TimePoint> saved_at{};
};

/// Returns the command of a stored message if its outcome is owed, else null. Checks the values
/// from the disk.
std::shared_ptr<Command> command_of(const MessageSnapshot& message, const SessionSnapshot& snapshot,
                                    TimePoint now);

SessionSnapshot to_snapshot(const ClientSession& session, TimePoint now);
/// Removes commands younger than `limits::stored_command_age`. Returns false if there are none.
bool leave_out_young_commands(SessionSnapshot& snapshot);
/// Returns what another gateway needs to continue the session: keep-alive, will, subscriptions, and
/// the topics that the client uses. Leaves out its address and all messages to it.
SessionSnapshot to_note(const SessionSnapshot& snapshot);
/// Fills a fresh session. The caller sets its state, binding, timers and broker subscriptions.
void apply(const SessionSnapshot& snapshot, ClientSession& session, TimePoint now);

/// Encodes a session for the store and for notes: CBOR (RFC 8949) of a map with a `version`. The
/// decoder ignores members that it does not know.
Bytes encode_session(SessionSnapshot snapshot);
/// Returns nothing if the octets are damaged or of another version.
std::optional<SessionSnapshot> decode_session(ByteView content);

}  // namespace slamgw::mqttsn
