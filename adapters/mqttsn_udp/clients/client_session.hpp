// SPDX-License-Identifier: Apache-2.0
// What the gateway keeps about one client (MQTT-SN 1.2 sections 6.3 and 6.14): values only. Each
// part is changed by the class of its concern; ClientTable owns the sessions.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/clients/topic_table.hpp"
#include "adapters/mqttsn_udp/conversations/repeat_filter.hpp"
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

enum class ClientState : std::uint8_t { active, asleep, awake, disconnected, lost };

struct Will {
  std::string topic;
  Bytes message;
  Qos qos = Qos::at_most_once;
  bool retain = false;
};

/// A new subscriber gets the retained messages that the broker sends because of it, each topic once
/// (R102).
struct RetainedWait {
  std::optional<TimePoint> until{};  ///< nothing: the broker has not answered yet, or is away
  std::set<std::string, std::less<>> seen;
};

struct Subscription {
  Qos qos = Qos::at_most_once;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t topic_id = 0;  ///< 0 for wildcards and short names
  std::uint16_t msg_id = 0;    ///< of the SUBSCRIBE that made it, to know its repetition
  std::optional<TimePoint> granted_at;
  std::optional<RetainedWait> retained_wait;
};

/// A message under `<prefix>/server/<robot>/<type>`, whose outcome is told exactly once.
struct Command {
  CommandId id = CommandId::none;  ///< none: from before a restart
  std::string robot;
  std::string type;
  TimePoint came{};
  bool is_reported = false;
};

/// One message on its way to one client.
struct Outgoing {
  std::shared_ptr<const BrokerMessage> message;
  Qos qos = Qos::at_most_once;  ///< min(message, granted)
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t predefined_id = 0;
  std::shared_ptr<Command> command;  ///< may be null
  bool was_refused_once = false;     ///< "invalid topic id": said again once (R86)
  std::size_t octets() const { return message->topic.size() + message->payload.size(); }
};

/// The one exchange that is open with a client (R66, R91).
struct InFlight {
  enum class Stage : std::uint8_t { registering, published, released };  // released: PUBREL sent
  Outgoing what;
  Stage stage = Stage::published;
  std::uint16_t msg_id = 0;
  std::uint16_t topic_id = 0;
  std::uint16_t resumed_msg_id = 0;     ///< while registering: the PUBLISH goes on under this id
  bool was_sent = false;                ///< the PUBLISH once left: from now on with DUP
  unsigned repeats = 0;                 ///< since the last sign of life
  std::optional<TimePoint> retry_at{};  ///< nothing: it rests until the client is heard
};

struct Delivery {
  std::vector<Outgoing> queue;  ///< a std::deque takes 576 octets also when empty
  std::size_t queued_octets = 0;
  std::optional<InFlight> in_flight;
  std::uint16_t last_msg_id = 0;
  std::optional<TimePoint> paused_until;  ///< the client said "congestion" (T_WAIT)
  bool is_stalled = false;                ///< no answer after N_retry: rests until heard (R133)
  std::size_t wake_budget = 0;            ///< messages that this wake-up may still bring (R122)
  std::optional<Outgoing> last_qos0;      ///< for "invalid topic id" at QoS 0 (R86)
  std::uint16_t last_qos0_id = 0;
};

/// A QoS 2 message from a client, between PUBLISH and PUBREL (R75).
struct InboundQos2 {
  std::uint64_t fingerprint = 0;
  std::uint64_t receipt_id = 0;  ///< 0: safe, PUBREC was sent
};

/// An answer that keeps its place while the broker thinks about a SUBSCRIBE before it (R64).
struct PendingAnswer {
  std::uint64_t ticket = 0;
  std::uint16_t msg_id = 0;
  std::optional<Packet> packet;
};

struct ClientSession {
  std::string client_id;
  std::string robot;
  std::uint64_t serial = 0;  ///< in the order of their first CONNECT

  ClientState state = ClientState::disconnected;
  std::optional<Peer> peer;
  LocalAddress local;
  bool is_clean = true;
  std::chrono::seconds keep_alive{0};
  std::chrono::seconds sleep_duration{0};
  TimePoint last_heard{};
  std::uint64_t connect_fingerprint = 0;  ///< of the last CONNECT; 0 once something else came (R35)
  TimePoint connected_at{};
  std::optional<Presence> told_presence;  ///< what the core was told last, and where
  std::optional<Peer> told_peer;

  std::optional<Will> will;
  TopicTable topics;
  std::map<std::string, Subscription, std::less<>> subscriptions;
  std::vector<PendingAnswer> answers;
  Delivery delivery;
  RepeatFilter repeats;
  std::map<std::uint16_t, InboundQos2> inbound_qos2;
  std::size_t open_receipts = 0;

  bool was_told_publish_rule = false;  ///< the operator's notice, once per device
  bool was_told_subscribe_rule = false;
  std::optional<TimePoint> timer_armed;
  std::optional<TimePoint> evictable_armed;

  bool is_connected() const {
    return state != ClientState::disconnected && state != ClientState::lost;
  }
};

}  // namespace slamgw::mqttsn
