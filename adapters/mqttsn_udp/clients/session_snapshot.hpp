// SPDX-License-Identifier: Apache-2.0
// What of a session survives a restart of the daemon (R47; docs/topics.md, promise 7), as
// values that a store can write. Not: acknowledgements owed for messages that were not safe yet
// (the robot repeats them).
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

/// An undelivered QoS 1 or 2 message, the one that awaits its acknowledgement first.
struct MessageSnapshot {
  BrokerMessage message;
  Qos qos = Qos::at_least_once;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t predefined_id = 0;
  std::uint16_t msg_id = 0;  ///< not 0: it was sent under this id
  /// How long a command without an outcome has waited.
  std::optional<std::chrono::milliseconds> command_age{};
};

/// A recently acknowledged message: its repetition is acknowledged again and not reported (R76).
struct RepeatSnapshot {
  std::uint16_t msg_id = 0;
  std::uint16_t topic_id = 0;
  std::uint64_t fingerprint = 0;
  std::chrono::milliseconds age{0};  ///< when the snapshot was taken
};

struct SessionSnapshot {
  std::string client_id;
  std::string robot;
  ClientState state = ClientState::disconnected;  ///< never awake
  std::optional<Peer> peer;
  LocalAddress local;
  bool is_validated = true;     ///< its address has shown that it receives
  std::uint32_t allowance = 0;  ///< else: octets that may be sent there
  bool is_clean = true;
  bool has_answered = false;
  bool uses_client_id = false;
  std::chrono::seconds keep_alive{0};
  std::chrono::seconds sleep_duration{0};
  std::optional<Will> will;
  std::vector<TopicTable::Topic> topics;
  std::vector<SubscriptionSnapshot> subscriptions;
  std::vector<MessageSnapshot> messages;
  std::vector<std::uint16_t> released;  ///< MsgIds of QoS 2: PUBREC came, PUBREL is due
  std::vector<std::pair<std::uint16_t, std::uint64_t>> inbound_qos2;  ///< MsgId, fingerprint
  std::vector<RepeatSnapshot> repeats;                                ///< oldest first
  bool counts_ids = false;                                            ///< see RepeatFilter
  std::uint16_t last_msg_id = 0;
  /// When the snapshot was taken. The clock goes on over a restart of the daemon, not of the host.
  std::optional<TimePoint> saved_at{};
};

/// A command whose outcome is owed, from what the disk had: checked.
std::shared_ptr<Command> command_of(const MessageSnapshot& message, const SessionSnapshot& snapshot,
                                    TimePoint now);

SessionSnapshot to_snapshot(const ClientSession& session, TimePoint now);
/// Removes commands that are younger than `limits::stored_command_age`. False: there are none.
bool leave_out_young_commands(SessionSnapshot& snapshot);
/// What another gateway needs of it: names of topics, never messages. The client's address, ids and
/// messages of this gateway are left out.
SessionSnapshot to_note(const SessionSnapshot& snapshot);
/// Fills a fresh session; its state, binding, timers and broker subscriptions are the caller's.
void apply(const SessionSnapshot& snapshot, ClientSession& session, TimePoint now);

/// As octets for the store and for notes, and back: CBOR (RFC 8949) of a map with a `version`;
/// members that this version does not know are ignored.
Bytes encode_session(const SessionSnapshot& snapshot);
/// Nothing when the octets are damaged or of a newer version.
std::optional<SessionSnapshot> decode_session(ByteView content);

}  // namespace slamgw::mqttsn
