// SPDX-License-Identifier: Apache-2.0
// The gateway's record of one client (MQTT-SN 1.2 sections 6.3 and 6.14): values only. Each part is
// changed by the class that handles it; ClientTable owns the sessions.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/clients/topic_table.hpp"
#include "adapters/mqttsn_udp/conversations/repeat_filter.hpp"
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/token_bucket.hpp"

namespace slamgw::mqttsn {

enum class ClientState : std::uint8_t { active, asleep, awake, disconnected, lost };

constexpr Presence presence_of(ClientState state) {
  switch (state) {
    case ClientState::active: return Presence::online;
    case ClientState::asleep:
    case ClientState::awake: return Presence::asleep;
    case ClientState::disconnected:
    case ClientState::lost: break;
  }
  return Presence::offline;
}

struct Will {
  std::string topic;
  Bytes message;
  Qos qos = Qos::at_most_once;
  bool retain = false;
};

struct Subscription {
  Qos qos = Qos::at_most_once;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t topic_id = 0;  ///< 0 for wildcards and short names
  std::uint16_t msg_id = 0;    ///< of its SUBSCRIBE, to recognise a repetition
  std::optional<TimePoint> granted_at;
};

/// An answer that keeps its place while an earlier SUBSCRIBE waits for the broker (R64).
struct PendingAnswer {
  Packet packet;
  std::uint16_t msg_id = 0;
  std::string filter;  ///< not empty: the filter of a SUBACK that waits for the broker
};

/// The part of a session that a snapshot copies as it is.
struct SessionTerms {
  LocalAddress local;
  bool is_clean = true;
  bool uses_client_id = false;  ///< the client is renamed, and its topics contain its client id
  std::chrono::seconds keep_alive{0};
  std::chrono::seconds sleep_duration{0};  ///< 0 if the client was active since it last slept
};

class ClientSession : public SessionTerms {
 public:
  std::string client_id;
  std::string robot;

  std::optional<Peer> peer;
  /// The client has answered something that only the owner of its address can have read. Clients
  /// without such an answer lose their places first.
  bool has_answered = false;
  TimePoint last_heard{};
  TimePoint sign_of_life_reported{};      ///< when a sign of life was last reported
  std::uint64_t connect_fingerprint = 0;  ///< of the last CONNECT; 0 once something else came (R35)
  TimePoint connected_at{};
  std::optional<Presence> reported_presence;  ///< the last presence that was reported
  std::size_t reported_peer = 0;              ///< PeerHash of `peer` at that report
  bool reported_contested = false;
  /// CONNECTs from other addresses while the client was active, since `first_takeover`.
  unsigned takeovers = 0;
  TimePoint first_takeover{};
  TimePoint contested_until{};
  std::uint64_t note_hash = 0;  ///< of the last NoteChanged; 0: there is none
  /// Not null: the former gateway's note could not be read yet, and holds more than this session.
  /// Holds the filters that the client has unsubscribed since.
  std::unique_ptr<std::set<std::string>> dropped_before_note;

  std::unique_ptr<Will> will;  ///< may be null
  TopicTable topics;
  std::map<std::string, Subscription, std::less<>> subscriptions;
  std::size_t filter_octets = 0;  ///< of `subscriptions`, charged to the NameBudget
  TokenBucket subscribe_rate;
  std::vector<PendingAnswer> answers;
  Delivery delivery;
  RepeatFilter repeats;
  std::size_t open_receipts = 0;

  // The session's entries in the timer queues of ClientTable.
  std::optional<TimePoint> timer_armed;
  std::optional<TimePoint> evictable_armed;

  ClientState state() const { return state_; }
  bool is_connected() const {
    return state_ != ClientState::disconnected && state_ != ClientState::lost;
  }
  /// Like TopicTable::assign(), but never reuses an id that an open REGISTER or PUBLISH names.
  std::optional<std::uint16_t> assign_topic(std::string_view name) {
    if (const auto known = topics.id_of(name)) return known;
    std::vector<std::uint16_t> in_use{delivery.last_qos0_id};
    if (delivery.publishing) in_use.push_back(delivery.publishing->topic_id);
    for (const Registering& open : delivery.registering) in_use.push_back(open.topic_id);
    return topics.assign(name, in_use);
  }

 private:
  friend class Lifecycle;  // nothing else writes state_

  ClientState state_ = ClientState::disconnected;
};

}  // namespace slamgw::mqttsn
