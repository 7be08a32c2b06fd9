// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/connecting.hpp"

#include <fmt/format.h>

#include <utility>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

/// Returns true if a CONNECT without CleanSession resumes this session (section 6.14, R36, R125).
/// It was to be kept, or it still goes on: the robot wakes or has a new address.
bool can_resume(const ClientSession& session) {
  return !session.is_clean || session.is_connected();
}

}  // namespace

void Connecting::on_connect(const Arrival& arrival, const Connect& connect) {
  const Peer& peer = arrival.peer;
  const TimePoint now = arrival.now;
  auto robot = rules_.robot_at(peer, connect.client_id);
  if (!robot || connect.protocol != protocol_id) return refuse_name(arrival, connect);
  if (is_repetition(arrival, connect)) {
    ClientSession& session = *clients_.find(peer);
    lifecycle_.note_heard(session, now);
    session.connect_fingerprint = arrival.fingerprint;
    return output_.send(session, Connack{ReturnCode::accepted});
  }
  const bool is_known = clients_.find(connect.client_id) != nullptr;
  if (!is_known && !lifecycle_.make_room(peer, now)) return refuse_for_place(arrival);
  Attempt attempt{
      arrival.local, connect, std::move(*robot), arrival.fingerprint, Stage::topic, {}, 0, {}};
  if (connect.will) return begin(arrival, std::move(attempt));
  if (is_open(peer)) take(peer);
  const ClientSession* known = clients_.find(connect.client_id);
  std::optional<Will> kept;
  const bool may_keep = known && can_resume(*known) && !connect.clean_session;  // R45
  if (may_keep && known->will) kept = *known->will;
  complete(arrival, attempt, std::move(kept));
}

/// Returns true if the CONNECT is a copy because its CONNACK was lost. CONNACK is sent again, and
/// nothing that was registered since is wiped (R35).
bool Connecting::is_repetition(const Arrival& arrival, const Connect& connect) const {
  const ClientSession* session = clients_.find(arrival.peer);
  return session && session->client_id == connect.client_id &&
         session->state() == ClientState::active &&
         session->connect_fingerprint == arrival.fingerprint &&
         arrival.now - session->connected_at <= limits::repeat_window;
}

void Connecting::on_willtopic(const Arrival& arrival, const WillTopic& will) {
  const Peer& peer = arrival.peer;
  Attempt& attempt = attempts_.at(peer);
  attempt.local = arrival.local;
  if (will.topic.empty())  // deletes the stored will; no message is asked for (R25)
    return complete(arrival, take(peer), std::nullopt);
  auto topic = wills_.allowed_topic(attempt.connect.client_id, attempt.robot, will.topic, will.qos,
                                    arrival.now);
  if (!topic) {
    take(peer);
    output_.count(Count::connects_refused);
    return answer_refused(arrival, ReturnCode::not_supported);
  }
  attempt.will = {std::move(*topic), {}, static_cast<Qos>(will.qos), will.retain};
  attempt.stage = Stage::message;
  attempt.repeats = 0;
  prompt(peer, attempt, arrival.now);
}

void Connecting::on_willmsg(const Arrival& arrival, WillMsg will) {
  if (attempts_.at(arrival.peer).stage == Stage::topic) return abandon(arrival.peer);
  Attempt done = take(arrival.peer);
  done.will.message = std::move(will.message);
  complete(arrival, done, done.will);
}

void Connecting::on_late_willmsg(const ClientSession& session, const WillMsg& will, TimePoint now) {
  const bool is_repetition = session.connect_fingerprint != 0 && session.will &&
                             session.will->message == will.message &&
                             now - session.connected_at <= limits::repeat_window;
  if (!is_repetition) return output_.count(Count::unexpected);
  output_.send(session, Connack{ReturnCode::accepted});
}

void Connecting::abandon(const Peer& peer) {
  const Attempt attempt = take(peer);
  output_.send(peer, attempt.local, Disconnect{});
}

void Connecting::on_deadline(TimePoint now) {
  while (const auto peer = timers_.pop_due(now)) {
    Attempt& attempt = attempts_.at(*peer);
    attempt.armed.reset();
    if (attempt.repeats >= settings_.retry_count) {  // R27: the client repeats CONNECT
      output_.count(Count::handshakes_given_up);
      take(*peer);
      continue;
    }
    ++attempt.repeats;
    if (output_.validation.is_validated(peer->endpoint.address)) {
      output_.count(Count::retransmitted);
      prompt(*peer, attempt, now);
    } else {  // the client repeats its CONNECT or WILLTOPIC when this was lost
      timers_.arm_by(attempt.armed, *peer, now + settings_.retry_interval);
    }
  }
}

void Connecting::begin(const Arrival& arrival, Attempt attempt) {
  const Peer& peer = arrival.peer;
  if (is_open(peer)) take(peer);  // R28: from the beginning
  if (!make_room())
    return refuse_for_room(arrival, fmt::format("{} clients with wills are connecting already",
                                                limits::max_handshakes));
  const bool is_stranger = !clients_.find(attempt.connect.client_id);
  Attempt& added = attempts_[peer] = std::move(attempt);
  if (is_stranger) strangers_.emplace(added.stranger = ++last_stranger_, peer);
  prompt(peer, added, arrival.now);
}

/// An attacker who makes up client ids must not shut out robots. A handshake takes one round trip,
/// so a stranger's oldest unfinished handshake is the least likely to be honest.
bool Connecting::make_room() {
  if (attempts_.size() < limits::max_handshakes) return true;
  if (strangers_.empty()) return false;
  output_.count(Count::handshakes_given_up);
  take(Peer(strangers_.begin()->second));
  return true;
}

void Connecting::prompt(const Peer& peer, Attempt& attempt, TimePoint now) {
  if (attempt.stage == Stage::topic) {
    output_.send(peer, attempt.local, WillTopicReq{});
  } else {
    output_.send(peer, attempt.local, WillMsgReq{});
  }
  timers_.disarm(attempt.armed, peer);
  timers_.arm_by(attempt.armed, peer, now + settings_.retry_interval);
}

Connecting::Attempt Connecting::take(const Peer& peer) {
  const auto found = attempts_.find(peer);
  Attempt attempt = std::move(found->second);
  timers_.disarm(attempt.armed, peer);
  strangers_.erase(attempt.stranger);
  attempts_.erase(found);
  return attempt;
}

void Connecting::complete(const Arrival& arrival, const Attempt& attempt,
                          std::optional<Will> will) {
  const Peer& peer = arrival.peer;
  const TimePoint now = arrival.now;
  const Connect& connect = attempt.connect;
  const auto robot =
      rules_.robot_at(peer, connect.client_id);  // names may change during the handshake
  if (!robot) return refuse_name(arrival, connect);
  if (will && *robot != attempt.robot) {
    auto own = replace_robot(rules_.policy.scheme(), will->topic, attempt.robot, *robot);
    if (own) will->topic = std::move(*own);
  }
  ClientSession* former = clients_.find(peer);
  if (former && former->client_id != connect.client_id) lifecycle_.displace(*former, now);  // R37
  ClientSession* session = clients_.find(connect.client_id);
  const bool begins_anew = connect.clean_session || (session && !can_resume(*session));
  if (!session) {
    if (!lifecycle_.make_room(peer, now)) return refuse_for_place(arrival);
    session = &clients_.create(connect.client_id, *robot);
  }
  if (session->state() == ClientState::active && session->peer && *session->peer != peer)
    on_takeover(*session, peer, now);
  if (begins_anew) {
    output_.emit(SessionCleaned{Mesh::thread, session->robot});
    lifecycle_.clean(*session, "the robot has begun a new session", now);
  } else {
    session->topics.forget_known();  // R48
    session->answers.clear();
    downlink_.on_reconnect(*session);
  }
  session->will = will ? std::make_unique<Will>(std::move(*will)) : nullptr;
  session->is_clean = connect.clean_session;
  session->keep_alive = std::chrono::seconds(connect.duration_s);
  session->connect_fingerprint = attempt.fingerprint;
  session->connected_at = now;
  if (clients_.bind(*session, peer, arrival.local)) downlink_.on_address(*session);
  output_.count(Count::connects);
  output_.send(*session, Connack{ReturnCode::accepted});
  lifecycle_.enter(*session, ClientState::active, now);
  if (!session->has_answered) clients_.set_evictable(*session, now + limits::crowd_patience);
  output_.mark_changed(*session);
}

/// Contests a client id whose address changes again and again. A robot that moves or starts again
/// has a new address, too, but not that often.
void Connecting::on_takeover(ClientSession& session, const Peer& peer, TimePoint now) {
  if (now - session.first_takeover > limits::contest_window) {
    session.first_takeover = now;
    session.takeovers = 0;
  }
  const bool was_contested = now < session.contested_until;
  if (++session.takeovers < limits::contested_takeovers && !was_contested) return;
  session.contested_until = now + limits::contest_window;
  const bool may_log = contest_lines_[session.has_answered].take(
      limits::refusal_lines_burst, limits::refusal_lines_per_second, now);
  if (was_contested || !may_log) return;
  output_.emit(
      Notice{.severity = Severity::warning,
             .text = fmt::format("{} and {} take the MQTT-SN client id '{}' from each other: two "
                                 "robots, or a robot and a foreign client, use it",
                                 to_string(*session.peer), to_string(peer), session.client_id),
             .robot = session.robot,
             .is_proven = session.has_answered});
}

void Connecting::refuse_name(const Arrival& arrival, const Connect& connect) {
  const Peer& peer = arrival.peer;
  const char* why = "another robot has this name, in the configuration or on another mesh";
  if (!rules_.names.may_come_from(connect.client_id, peer.endpoint.address))
    why = "the configuration has another address for it (robots[].address)";
  if (!peer.identity.empty() && peer.identity != connect.client_id)
    why = "its key belongs to another robot; over DTLS a client may use only its own id";
  if (rules_.names.is_client_banned(connect.client_id))
    why = "it is banned (slam-gatewayctl unban)";
  if (!is_valid_level(connect.client_id))
    why =
        "a client id must be one topic level of 1 to 64 octets, without + # / and control "
        "characters";
  if (connect.protocol != protocol_id) why = "its protocol is not MQTT-SN 1.2";
  refusals_.on_refusal(Count::connects_refused, connect.client_id,
                       fmt::format("{} may not connect as '{}' (CONNACK 0x03): {}", to_string(peer),
                                   connect.client_id.substr(0, limits::max_logged_id_octets), why),
                       is_valid_level(connect.client_id) ? connect.client_id : std::string{},
                       arrival.now);
  answer_refused(arrival, ReturnCode::not_supported);
}

void Connecting::answer_refused(const Arrival& arrival, ReturnCode code) {
  if (!guard_.may_answer(arrival.peer, arrival.now)) return output_.count(Count::unanswered);
  output_.send(arrival.peer, arrival.local, Connack{code});
}

void Connecting::refuse_for_place(const Arrival& arrival) {
  refuse_for_room(
      arrival, fmt::format("all {} places (mqttsn.max_clients) are taken", settings_.max_clients));
}

void Connecting::refuse_for_room(const Arrival& arrival, const std::string& why) {
  refusals_.on_refusal(Count::connects_refused, why,
                       fmt::format("{} and others can't connect: {}", to_string(arrival.peer), why),
                       {}, arrival.now);
  if (settings_.is_full_silent()) return;  // the client tries again (R33)
  answer_refused(arrival, ReturnCode::congestion);
}

}  // namespace slamgw::mqttsn
