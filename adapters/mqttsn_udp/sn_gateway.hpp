// SPDX-License-Identifier: Apache-2.0
// The MQTT-SN 1.2 gateway as a pure machine: datagrams, receipts, broker messages and time in,
// actions out (daemon/core/protocol_machine.hpp). Messages of clients go up over one broker
// connection; messages to a robot come down over the robot's own session (daemon/sessions). Routes
// each message to the class that handles it; MqttsnAdapter is its shell.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/conversations/connecting.hpp"
#include "adapters/mqttsn_udp/conversations/discovery.hpp"
#include "adapters/mqttsn_udp/conversations/operator_pings.hpp"
#include "adapters/mqttsn_udp/conversations/roaming.hpp"
#include "adapters/mqttsn_udp/conversations/uplink.hpp"

namespace slamgw::mqttsn {

class SnGateway {
 public:
  /// `random` makes MsgIds unforeseeable; without it they begin with 1.
  SnGateway(Settings settings, TopicPolicy policy, RobotNames names, RandomSource random = {},
            TopicIdOf topic_ids = topic_id_of);
  SnGateway(const SnGateway&) = delete;
  SnGateway& operator=(const SnGateway&) = delete;

  /// `identity`: the client id that a key has proven over DTLS; empty over plain UDP.
  void on_datagram(const Endpoint& from, const LocalAddress& to, ByteView bytes, TimePoint now,
                   const std::string& identity = {});
  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  void on_broker_message(const RobotMessage& message, TimePoint now);
  void on_subscribe_result(const std::string& robot, const std::string& filter, bool granted,
                           TimePoint now);
  void on_broker_link(bool is_up, TimePoint now) { discovery_.on_broker_link(is_up, now); }
  void on_interface(std::uint32_t index) { discovery_.on_interface(index); }
  void on_deadline(TimePoint now);
  std::optional<TimePoint> deadline() const;
  std::optional<Action> next_action() { return output_.next_action(); }

  /// Marks this address as validated: messages to it need no proof that it receives.
  void validate(const IpAddress& address) { output_.validation.validate(address); }

  /// Refuses clients whose robot's name belongs to another mesh (a device speaks only for itself),
  /// unless the configuration allows it.
  void refuse_names(NameCheck is_elsewhere) { rules_.is_elsewhere = std::move(is_elsewhere); }

  /// Sets the client ids that have a key. Call before the first input; later, call reconfigure().
  void use_identities(Identities identities) { rules_.identities = std::move(identities); }
  /// Applies a configuration that was read again. Sessions go on, under the new names of their
  /// robots; subscriptions that are no longer allowed end. A client that must prove its identity
  /// now has to connect again.
  void reconfigure(TopicPolicy policy, RobotNames names, Identities identities, TimePoint now);

  Counters counters() const;
  MeshPlaces places() const;
  /// Returns nothing when no client has this name.
  std::optional<Presence> presence_of(const std::string& robot) const;
  /// Returns the number of messages that wait for this robot, including the one in flight.
  std::size_t queued_for(const std::string& robot) const;

  /// Turns on the report of every MessageStep; else only repeats are reported.
  void on_trace(bool is_on) { output_.is_traced = is_on; }
  /// `ask` is called for each CONNECT that resumes a session which is not here.
  void ask_where_served(Roaming::ServedElsewhere ask) { roaming_.ask(std::move(ask)); }
  /// Call when another gateway serves the robot. Ends its session here without a will, a packet or
  /// a request to the broker. Returns the messages that were never on the air; commands that were
  /// on the air end as `timeout`.
  std::vector<WaitingMessage> give_up(const std::string& robot, TimePoint now);
  /// Call when this gateway holds the robot's session at the broker: reports its note again, or
  /// asks for a note that could not be read.
  void on_session_held(const std::string& robot);
  /// Ends the session of a robot that an operator wants forgotten.
  void forget(const std::string& robot, TimePoint now);
  /// Answers NoteRequest with the note of the robot's former gateway; empty: there is none;
  /// nothing: it cannot be read before on_session_held().
  void on_note(const std::string& robot, std::optional<ByteView> note, TimePoint now);

  /// Call when the daemon stops. Refuses undelivered messages that no session keeps.
  void on_stop(TimePoint now);

  /// Call once when there is a store: answers on which clients rely then wait until their sessions
  /// are saved.
  void answer_when_saved() { output_.answer_when_saved(); }
  bool has_unsaved_answers() const { return output_.has_unsaved_answers(); }
  /// Call when the sessions of the last take_changed() are saved, or when the store fails or hangs.
  void on_saved(bool is_saved, TimePoint now) { output_.on_saved(is_saved, now); }
  void send_unsaved() { output_.send_unsaved(); }
  /// Returns about `max` client ids of sessions that have changed or ended and were not taken yet.
  std::vector<std::string> take_changed(std::size_t max) { return output_.take_changed(max); }
  bool has_changed() const { return output_.has_changed(); }
  void set_changed(const std::string& client_id);
  /// Marks all sessions, to save also what changes too often to be marked each time (the window of
  /// R76).
  void set_all_dirty();
  /// Asks the robot for a sign of life; ends with PingEnded, which has this id.
  void ping(std::uint64_t id, const std::string& robot, TimePoint now) {
    pings_.ask(id, robot, now);
  }
  /// See client_report().
  nlohmann::json report(const std::optional<std::string>& robot, TimePoint now) const;
  /// See Restoring. Sessions are restored before the first datagram.
  std::optional<SessionSnapshot> snapshot(const std::string& client_id, TimePoint now) const {
    return restoring_.snapshot(client_id, now);
  }
  bool restore(const SessionSnapshot& snapshot, TimePoint now) {
    return restoring_.restore(snapshot, now);
  }

 private:
  void resume_connect(Roaming::WaitingConnect waited, std::optional<ByteView> note, TimePoint now);
  std::optional<SessionSnapshot> read_note(const std::string& client_id, const std::string& robot,
                                           ByteView note) const;
  void receive(const Arrival& arrival, Packet packet);
  void advance_client_at(const Arrival& arrival);
  bool receive_in_handshake(const Arrival& arrival, Packet& packet);
  void receive_from_client(const Arrival& arrival, Packet packet);
  void receive_pingreq(const Arrival& arrival, const Pingreq& pingreq);
  void receive_disconnect(const Arrival& arrival, const Disconnect& disconnect);
  bool lacks_identity(const Peer& peer, const Packet& packet, TimePoint now);
  void follow_identity(const Arrival& arrival, const Packet& packet);
  void renew_local(const Arrival& arrival);
  ClientSession* session_of(const Arrival& arrival);
  bool is_back(ClientSession& session, TimePoint now);
  ClientSession* pinging_session(const Arrival& arrival, const Pingreq& pingreq);
  void handle(ClientSession& session, Packet& packet, TimePoint now);
  void on_stranger(const Arrival& arrival, bool is_answered);
  void on_malformed(const Endpoint& from, TimePoint now, std::string_view why = {});

  const Settings settings_;
  NameRules rules_;
  ClientTable clients_;
  Output output_;
  Refusals refusals_;
  const Conversation common_;
  Answers answers_;
  Subscriptions subscriptions_;
  Downlink downlink_;
  Uplink uplink_;
  Wills wills_;
  Lifecycle lifecycle_;
  Supervision supervision_;
  Roaming roaming_;
  Notes notes_;
  FloodGuard guard_;
  Connecting connecting_;
  Renaming renaming_;
  Restoring restoring_;
  Discovery discovery_;
  OperatorPings pings_;
  LogThrottle malformed_;
};

}  // namespace slamgw::mqttsn
