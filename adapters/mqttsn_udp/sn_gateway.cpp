// SPDX-License-Identifier: Apache-2.0
// Routes each datagram to the class that handles it, by its sender, the state of that client, and
// whether the message fits the state (MQTT-SN 1.2 section 6.14). Then the inputs that do not come
// from clients.
#include "adapters/mqttsn_udp/sn_gateway.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

template <class... Types>
bool is_one_of(const Packet& packet) {
  return (std::holds_alternative<Types>(packet) || ...);
}

/// Returns true for messages that are never meant for a gateway (R6).
bool is_for_clients(const Packet& packet) {
  return is_one_of<Advertise, GwInfo, Connack, WillTopicReq, WillMsgReq, Suback, Unsuback,
                   WillTopicResp, WillMsgResp>(packet);
}

/// Returns true for messages that are dropped when they come from a stranger. All others are
/// answered with DISCONNECT (R39).
bool is_silent_from_strangers(const Packet& packet) {
  return is_one_of<Pingresp, WillTopic, WillMsg>(packet);
}

/// Returns true for answers to earlier requests of the gateway, which do not end a handshake (R29).
bool is_late_answer(const Packet& packet) {
  return is_one_of<Pingresp, Regack, Puback, Pubrec, Pubcomp>(packet);
}

}  // namespace

SnGateway::SnGateway(Settings settings, TopicPolicy policy, RobotNames names, RandomSource random,
                     TopicIdOf topic_ids)
    : settings_(std::move(settings)),
      rules_{std::move(policy), std::move(names), PredefinedTopics(settings_.predefined_topics),
             settings_.require_identity},
      clients_(settings_.max_clients, topic_ids),
      output_(settings_.max_clients),
      refusals_(clients_, output_),
      common_(settings_, rules_, clients_, output_, refusals_),
      answers_(common_),
      subscriptions_(common_, answers_),
      downlink_(common_, subscriptions_, std::move(random)),
      uplink_(common_, answers_),
      wills_(common_),
      lifecycle_(common_, subscriptions_, downlink_, wills_),
      supervision_(common_, downlink_, lifecycle_),
      roaming_(common_),
      notes_(common_),
      connecting_(common_, lifecycle_, downlink_, wills_, guard_),
      renaming_(common_, subscriptions_, lifecycle_),
      restoring_(common_, subscriptions_, downlink_, lifecycle_, supervision_),
      discovery_(common_, guard_),
      pings_(common_) {}

void SnGateway::on_datagram(const Endpoint& from, const LocalAddress& to, ByteView bytes,
                            TimePoint now, const std::string& identity) {
  output_.count(Count::datagrams_in);
  if (rules_.names.bans().covers(from.address)) return output_.count(Count::banned);
  if (!identity.empty()) output_.validation.validate(from.address);
  output_.validation.on_received(from.address, bytes.size());
  if (bytes.size() > limits::max_datagram_octets) {
    output_.count(Count::oversized);
    return on_malformed(from, now, "; it has more octets than Thread carries");
  }
  Peer peer{from, {}, identity};
  std::uint8_t radius = 0;
  if (is_encapsulated(bytes)) {
    if (!settings_.forwarders) return output_.count(Count::unexpected);
    auto outer = decode_encapsulation(bytes);
    if (!outer) return on_malformed(from, now);
    peer.node_id = std::move(outer->node_id);
    radius = outer->radius;
    bytes = outer->inner;
  }
  Result<Packet, DecodeError> packet = decode(bytes);
  if (!packet) return on_malformed(from, now);
  if (lacks_identity(peer, *packet, now)) return;
  const Arrival arrival{std::move(peer), to, fingerprint(bytes), now};
  if (const auto* search = std::get_if<SearchGw>(&*packet))
    return discovery_.on_searchgw(arrival, arrival.peer.node_id.empty() ? search->radius : radius);
  receive(arrival, std::move(*packet));
}

/// Returns true if the sender came over plain UDP but must come over DTLS; it gets no answer. Only
/// CONNECT and PINGREQ name their client.
bool SnGateway::lacks_identity(const Peer& peer, const Packet& packet, TimePoint now) {
  if (!peer.identity.empty() || rules_.required == RequireIdentity::none) return false;
  std::string client_id;
  if (const auto* connect = std::get_if<Connect>(&packet)) client_id = connect->client_id;
  if (const auto* pingreq = std::get_if<Pingreq>(&packet)) client_id = pingreq->client_id;
  if (!rules_.needs_identity(client_id)) return false;
  const std::string from = to_string(peer);
  const std::string who =
      client_id.empty()
          ? from
          : fmt::format("{} as '{}'", from, client_id.substr(0, limits::max_logged_id_octets));
  refusals_.on_refusal(
      Count::identity_missing, client_id.empty() ? from : client_id,
      fmt::format("{} gets no answer: it must come over DTLS (mqttsn.require_identity)", who),
      is_valid_level(client_id) ? client_id : std::string{}, now);
  return true;
}

void SnGateway::receive(const Arrival& arrival, Packet packet) {
  if (is_for_clients(packet)) return output_.count(Count::unexpected);
  renew_local(arrival);
  follow_identity(arrival, packet);
  if (const auto* connect = std::get_if<Connect>(&packet)) {
    if (roaming_.takes(arrival, *connect)) return;
    connecting_.on_connect(arrival, *connect);
    return advance_client_at(arrival);
  }
  auto* publish = std::get_if<Publish>(&packet);
  if (publish && publish->qos == WireQos::minus_one) {
    ClientSession* session = clients_.find(arrival.peer);
    if (session && session->is_connected()) lifecycle_.on_heard(*session, arrival.now);
    return uplink_.on_unconnected_publish(arrival.peer, session, std::move(*publish), arrival.now);
  }
  if (connecting_.is_open(arrival.peer) && receive_in_handshake(arrival, packet))
    return advance_client_at(arrival);
  if (const auto* pingreq = std::get_if<Pingreq>(&packet))
    return receive_pingreq(arrival, *pingreq);
  if (const auto* disconnect = std::get_if<Disconnect>(&packet))
    return receive_disconnect(arrival, *disconnect);
  receive_from_client(arrival, std::move(packet));
}

/// Each client is answered from the address that it has written to last (R17).
void SnGateway::renew_local(const Arrival& arrival) {
  ClientSession* session = clients_.find(arrival.peer);
  if (!session || session->local == arrival.local) return;
  session->local = arrival.local;
  output_.mark_unsaved(*session);
}

/// A robot that has made a new DTLS connection goes on with its session, as if it had not moved.
void SnGateway::follow_identity(const Arrival& arrival, const Packet& packet) {
  const Peer& peer = arrival.peer;
  if (peer.identity.empty() || std::holds_alternative<Connect>(packet) || clients_.find(peer) ||
      connecting_.is_open(peer) || !rules_.may_speak(peer.identity, peer))
    return;
  ClientSession* session = clients_.find(peer.identity);
  if (session && session->state() != ClientState::disconnected)
    supervision_.follow(*session, arrival);
}

/// Sends what the client at this address may get now: a handshake may have made it active.
void SnGateway::advance_client_at(const Arrival& arrival) {
  if (ClientSession* session = clients_.find(arrival.peer))
    supervision_.advance(*session, arrival.now);
}

/// Returns true if the message belonged to the handshake or ended it.
bool SnGateway::receive_in_handshake(const Arrival& arrival, Packet& packet) {
  if (const auto* topic = std::get_if<WillTopic>(&packet)) {
    connecting_.on_willtopic(arrival, *topic);
  } else if (auto* message = std::get_if<WillMsg>(&packet)) {
    connecting_.on_willmsg(arrival, std::move(*message));
  } else if (is_late_answer(packet)) {
    return false;
  } else {
    connecting_.abandon(arrival.peer);
  }
  return true;
}

void SnGateway::receive_from_client(const Arrival& arrival, Packet packet) {
  ClientSession* session = session_of(arrival);
  if (!session) return on_stranger(arrival, !is_silent_from_strangers(packet));
  if (const auto* will = std::get_if<WillMsg>(&packet))
    return connecting_.on_late_willmsg(*session, *will, arrival.now);
  if (std::holds_alternative<WillTopic>(packet))  // of a handshake that is over
    return output_.count(Count::unexpected);
  lifecycle_.on_heard(*session, arrival.now);
  if (const auto* request = std::get_if<Register>(&packet))
    session->repeats.on_request(request->msg_id);
  if (const auto* request = std::get_if<Subscribe>(&packet))
    session->repeats.on_request(request->msg_id);
  downlink_.expire_commands(*session, arrival.now);
  handle(*session, packet, arrival.now);
  supervision_.advance(*session, arrival.now);
}

/// Returns the connected client at this address.
ClientSession* SnGateway::session_of(const Arrival& arrival) {
  ClientSession* session = clients_.find(arrival.peer);
  return session && is_back(*session, arrival.now) ? session : nullptr;
}

/// Returns true for a connected client. A lost one comes back with its message (R113).
bool SnGateway::is_back(ClientSession& session, TimePoint now) {
  return session.is_connected() || lifecycle_.revive(session, now);
}

void SnGateway::handle(ClientSession& session, Packet& packet, TimePoint now) {
  std::visit(overloaded{
                 [&](const Register& p) { uplink_.on_register(session, p, now); },
                 [&](const Regack& p) { downlink_.on_regack(session, p, now); },
                 [&](Publish& p) { uplink_.on_publish(session, std::move(p), now); },
                 [&](const Puback& p) { downlink_.on_puback(session, p, now); },
                 [&](const Pubrec& p) { downlink_.on_pubrec(session, p, now); },
                 [&](const Pubrel& p) { uplink_.on_pubrel(session, p, now); },
                 [&](const Pubcomp& p) { downlink_.on_pubcomp(session, p, now); },
                 [&](const Subscribe& p) { subscriptions_.on_subscribe(session, p, now); },
                 [&](const Unsubscribe& p) {
                   if (const auto filter = subscriptions_.on_unsubscribe(session, p, now))
                     downlink_.drop_unwanted(session, *filter, now);
                 },
                 [&](const WillTopicUpd& p) { wills_.on_willtopicupd(session, p, now); },
                 [&](WillMsgUpd& p) { wills_.on_willmsgupd(session, std::move(p)); },
                 [&](const Pingresp&) { pings_.on_pingresp(session, now); },
                 [](const auto&) {},
             },
             packet);
}

void SnGateway::receive_pingreq(const Arrival& arrival, const Pingreq& pingreq) {
  ClientSession* session = pinging_session(arrival, pingreq);
  if (!session || !is_back(*session, arrival.now)) return on_stranger(arrival, true);
  lifecycle_.on_heard(*session, arrival.now);
  if (!pingreq.client_id.empty()) Downlink::on_named_ping(*session);
  if (session->state() == ClientState::active)
    output_.send(*session, Pingresp{});
  else
    supervision_.wake(*session, arrival.now);
  supervision_.advance(*session, arrival.now);
}

/// Returns the session of the client that pings; null when it may not ping from this address. A
/// sleeping client may use any address that NameRules allow (R118), others only their own
/// (R113, R128).
ClientSession* SnGateway::pinging_session(const Arrival& arrival, const Pingreq& pingreq) {
  ClientSession* here = clients_.find(arrival.peer);
  if (pingreq.client_id.empty() || (here && here->client_id == pingreq.client_id)) return here;
  ClientSession* session = clients_.find(pingreq.client_id);
  if (!session || !Supervision::is_asleep(*session)) return nullptr;
  if (!rules_.may_speak(session->client_id, arrival.peer)) return nullptr;
  supervision_.follow(*session, arrival);
  return session;
}

void SnGateway::receive_disconnect(const Arrival& arrival, const Disconnect& disconnect) {
  ClientSession* session = clients_.find(arrival.peer);
  const std::uint16_t duration_s = disconnect.duration_s.value_or(0);
  if (session && duration_s > 0) lifecycle_.revive(*session, arrival.now);
  if (!session || !session->is_connected()) {
    if (!guard_.may_answer(arrival.peer, arrival.now)) return output_.count(Count::unanswered);
    return output_.send(arrival.peer, arrival.local, Disconnect{});  // R40, R131
  }
  lifecycle_.on_heard(*session, arrival.now);
  output_.send(*session, Disconnect{});
  if (duration_s == 0) return lifecycle_.disconnect(*session, arrival.now);  // R115
  supervision_.fall_asleep(*session, std::chrono::seconds(duration_s), arrival.now);
  supervision_.advance(*session, arrival.now);
}

void SnGateway::on_stranger(const Arrival& arrival, bool is_answered) {
  output_.count(Count::strangers);
  if (!is_answered || !settings_.disconnect_unknown) return;
  if (!guard_.may_answer(arrival.peer, arrival.now)) return output_.count(Count::unanswered);
  output_.send(arrival.peer, arrival.local, Disconnect{});
}

void SnGateway::on_malformed(const Endpoint& from, TimePoint now, std::string_view why) {
  output_.count(Count::malformed);
  if (const auto times = malformed_.on_event(now)) {
    output_.emit(
        Notice{Severity::notice,
               fmt::format("dropped {} datagrams that are not MQTT-SN 1.2, the last from {}{}",
                           *times, to_string(Peer{from, {}}), why),
               {}});
  }
}

void SnGateway::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now) {
  uplink_.on_receipt(receipt_id, outcome, now);
}

void SnGateway::on_broker_message(const RobotMessage& message, TimePoint now) {
  ClientSession* session = clients_.find_robot(message.robot);
  if (session) {
    downlink_.on_broker_message(*session, message, now);
    return supervision_.advance(*session, now);
  }
  if (roaming_.keep(message, now)) return;
  downlink_.refuse_command(message.message, message.command, "the robot is not connected");
}

void SnGateway::on_subscribe_result(const std::string& robot, const std::string& filter,
                                    bool granted, TimePoint now) {
  ClientSession* session = clients_.find_robot(robot);
  if (!session) return;
  subscriptions_.on_subscribe_result(*session, filter, granted, now);
  if (!granted) downlink_.drop_unwanted(*session, filter, now);
  supervision_.advance(*session, now);
}

void SnGateway::on_deadline(TimePoint now) {
  discovery_.on_deadline(now);
  connecting_.on_deadline(now);
  while (auto waited = roaming_.take_overdue(now))
    resume_connect(std::move(*waited), std::nullopt, now);
  supervision_.on_deadline(now);
  notes_.on_deadline(now);
  pings_.on_deadline(now);
}

std::optional<TimePoint> SnGateway::deadline() const {
  return earlier(earlier(earlier(discovery_.deadline(), connecting_.deadline()), pings_.deadline()),
                 earlier(earlier(supervision_.deadline(), roaming_.deadline()), notes_.deadline()));
}

void SnGateway::reconfigure(TopicPolicy policy, RobotNames names, Identities identities,
                            TimePoint now) {
  rules_.policy = std::move(policy);
  rules_.names = std::move(names);
  rules_.identities = std::move(identities);
  refusals_.forget_all();
  renaming_.on_names(now);
  for (const auto& [id, session] : clients_.all()) {
    subscriptions_.drop_forbidden(*session);
    supervision_.advance(*session, now);
  }
}

nlohmann::json SnGateway::report(const std::optional<std::string>& robot, TimePoint now) const {
  return client_report(clients_, robot, settings_.retry_interval, now);
}

std::optional<Presence> SnGateway::presence_of(const std::string& robot) const {
  const ClientSession* session = clients_.find_robot(robot);
  if (!session) return roaming_.is_waiting(robot) ? std::optional(Presence::online) : std::nullopt;
  return mqttsn::presence_of(session->state());
}

std::size_t SnGateway::queued_for(const std::string& robot) const {
  const ClientSession* session = clients_.find_robot(robot);
  if (!session) return 0;
  return session->delivery.queue.size() + (session->delivery.publishing ? 1 : 0);
}

void SnGateway::on_stop(TimePoint now) {
  downlink_.on_stop();
  for (const auto& [id, session] : clients_.all()) downlink_.refuse_unkept(*session, now);
  for (const RobotMessage& unsent : roaming_.on_stop(now))
    downlink_.refuse_command(unsent.message, unsent.command, Downlink::stopped);
}

void SnGateway::set_changed(const std::string& client_id) {
  if (const ClientSession* session = clients_.find(client_id)) output_.mark_changed(*session);
}

void SnGateway::set_all_dirty() {
  for (const auto& [id, session] : clients_.all()) output_.mark_changed(*session);
}

Counters SnGateway::counters() const {
  Counters counters = output_.counters();
  counters.push_back({"clients", clients_.size()});
  counters.push_back({"clients_unanswered", clients_.unanswered()});
  return counters;
}

MeshPlaces SnGateway::places() const {
  return {settings_.max_clients, clients_.size(), clients_.largest_crowd(), clients_.unanswered(),
          clients_.largest_unanswered_crowd()};
}

std::vector<WaitingMessage> SnGateway::give_up(const std::string& robot, TimePoint now) {
  std::vector<WaitingMessage> unsent;
  if (ClientSession* session = clients_.find_robot(robot))
    unsent = lifecycle_.give_up(*session, now);
  while (auto waited = roaming_.take(robot)) {
    for (RobotMessage& message : waited->take_messages(now))
      unsent.push_back({std::move(message.message), message.command});
  }
  return unsent;
}

/// The note may have been lost while another gateway held the robot's session, or with the broker's
/// retained messages.
void SnGateway::on_session_held(const std::string& robot) {
  ClientSession* session = clients_.find_robot(robot);
  if (!session) return;
  if (session->dropped_before_note) return output_.emit(NoteRequest{Mesh::thread, robot});
  if (session->note_hash != 0) session->note_hash = Restoring::unknown_note_hash;
  output_.mark_noteworthy(*session);
}

void SnGateway::forget(const std::string& robot, TimePoint now) {
  if (ClientSession* session = clients_.find_robot(robot))
    lifecycle_.expel(*session, "an operator removed the robot (slam-gatewayctl forget)", now);
}

void SnGateway::on_note(const std::string& robot, std::optional<ByteView> note, TimePoint now) {
  if (auto waited = roaming_.take(robot)) return resume_connect(std::move(*waited), note, now);
  ClientSession* session = clients_.find_robot(robot);
  if (session && session->dropped_before_note && note)
    restoring_.complete(*session, read_note(session->client_id, robot, *note), now);
}

/// Continues a CONNECT that has waited. Without a note the session starts empty, and is kept.
void SnGateway::resume_connect(Roaming::WaitingConnect waited, std::optional<ByteView> note,
                               TimePoint now) {
  const std::string& client_id = waited.connect.client_id;
  if (!clients_.find(client_id) && lifecycle_.make_room(waited.arrival.peer, now)) {
    SessionSnapshot fresh;
    fresh.client_id = client_id;
    fresh.robot = waited.robot;
    fresh.is_clean = false;
    const auto known = note ? read_note(client_id, waited.robot, *note) : std::nullopt;
    restoring_.restore(known.value_or(std::move(fresh)), now);
    if (ClientSession* session = clients_.find(client_id)) {
      session->note_hash = known ? fingerprint(*note) : 0;
      if (!note) session->dropped_before_note = std::make_unique<std::set<std::string>>();
      clients_.set_evictable(*session, now + limits::crowd_patience);  // after the will's handshake
    }
  }
  waited.arrival.now = now;
  connecting_.on_connect(waited.arrival, waited.connect);
  advance_client_at(waited.arrival);
  for (const RobotMessage& message : waited.take_messages(now)) on_broker_message(message, now);
}

/// Reads a note, but takes from it only what the client itself could have requested here.
std::optional<SessionSnapshot> SnGateway::read_note(const std::string& client_id,
                                                    const std::string& robot, ByteView note) const {
  if (note.empty() || note.size() > limits::max_note_octets) return std::nullopt;
  std::optional<SessionSnapshot> session = decode_session(note);
  if (!session || session->robot != robot || session->client_id != client_id) return std::nullopt;
  session = to_note(*session);
  const auto is_forbidden = [&](const Will& will) {
    return !is_valid_topic_name(will.topic) ||
           !rules_.policy.may_publish(session->client_id, session->robot, will.topic);
  };
  if (session->will && is_forbidden(*session->will)) session->will.reset();
  return session;
}

}  // namespace slamgw::mqttsn
