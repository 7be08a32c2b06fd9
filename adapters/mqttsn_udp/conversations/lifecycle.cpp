// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"

#include <fmt/format.h>

#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void Lifecycle::on_heard(ClientSession& session, TimePoint now) {
  on_connect_again(session, now);
  if (now - session.sign_of_life_reported < limits::sign_of_life_interval) return;
  session.sign_of_life_reported = now;
  output_.emit(SignOfLife{Mesh::thread, session.robot});
  if (session.reported_contested && session.reported_presence)
    report_presence(session, *session.reported_presence, now);
}

void Lifecycle::on_connect_again(ClientSession& session, TimePoint now) {
  session.last_heard = now;
  session.connect_fingerprint = 0;
  downlink_.on_heard(session);
}

void Lifecycle::enter(ClientSession& session, ClientState state, TimePoint now) {
  session.state_ = state;
  switch (state) {
    case ClientState::active:
      session.last_heard = now;
      clients_.set_needed(session);
      return report_presence(session, Presence::online, now);
    case ClientState::asleep: session.last_heard = now; [[fallthrough]];
    case ClientState::awake: return report_presence(session, Presence::asleep, now);
    case ClientState::disconnected:
    case ClientState::lost: break;
  }
  const bool gives_way = session.is_clean || !session.has_answered;
  const Duration kept = gives_way ? Duration::zero() : Duration(limits::min_absence);
  clients_.set_evictable(session, now + kept);
  if (session.reported_presence) report_presence(session, Presence::offline, now);
}

bool Lifecycle::revive(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::lost || !settings_.revive_lost) return false;
  output_.count(Count::clients_revived);
  enter(session, ClientState::active, now);
  output_.mark_changed(session);
  return true;
}

void Lifecycle::disconnect(ClientSession& session, TimePoint now) {
  if (session.is_clean) return expel(session, "the robot has disconnected", now);
  leave(session, ClientState::disconnected, now);
}

void Lifecycle::lose(ClientSession& session, TimePoint now) {
  output_.count(Count::clients_lost);
  wills_.publish(session);
  const bool may_come_back = settings_.revive_lost && session.peer;
  if (session.is_clean && !may_come_back) return expel(session, "the robot is lost", now);
  leave(session, ClientState::lost, now);
}

void Lifecycle::displace(ClientSession& session, TimePoint now) {
  clients_.unbind(session);
  if (session.state() == ClientState::active) lose(session, now);
}

void Lifecycle::clean(ClientSession& session, const std::string& why, TimePoint now) {
  session.answers.clear();
  subscriptions_.forget_all(session);
  session.will.reset();
  session.topics.clear();
  uplink_.forget(session);
  downlink_.drop_all(session, why, now);
}

bool Lifecycle::make_room(const Peer& peer, TimePoint now) {
  while (clients_.is_full()) {
    ClientSession* gone = clients_.evictable(now);
    if (!gone) break;
    evict(*gone, now);
  }
  if (!clients_.is_full()) return true;
  const std::vector<ClientSession*> crowd = clients_.crowd(peer, now);
  if (crowd.empty()) return false;
  if (crowd_lines_.on_event(now))
    output_.emit(Notice{
        Severity::warning,
        fmt::format("mqttsn.max_clients ({}) is reached; clients that have not shown that they "
                    "receive give way, first '{}' at {}",
                    settings_.max_clients, crowd.front()->client_id,
                    to_string(*crowd.front()->peer)),
        {}});
  for (ClientSession* session : crowd) {
    output_.send(*session, Disconnect{});
    evict(*session, now);
  }
  return true;
}

/// Of a client that has not answered nothing is kept, its presence and its session at the broker
/// included.
void Lifecycle::evict(ClientSession& session, TimePoint now) {
  output_.count(Count::clients_evicted);
  const SessionEvicted evicted{Mesh::thread, session.robot};
  const bool has_answered = session.has_answered;
  if (session.reported_presence) report_presence(session, Presence::offline, now);
  forget(session, "the robot's session made room for another", now);
  if (!has_answered) output_.emit(evicted);
}

/// Reports each change of state or address once.
void Lifecycle::report_presence(ClientSession& session, Presence presence, TimePoint now) {
  const std::size_t place = session.peer ? PeerHash()(*session.peer) : 0;
  const bool is_same_place = presence == Presence::offline || session.reported_peer == place;
  const bool is_contested = now < session.contested_until;
  if (session.reported_presence == presence && is_same_place &&
      session.reported_contested == is_contested)
    return;
  session.reported_presence = presence;
  session.reported_peer = place;
  session.reported_contested = is_contested;
  output_.emit(PresenceChange{Mesh::thread, session.robot, presence,
                              session.peer ? to_string(*session.peer) : std::string(),
                              /*is_deaf=*/false, is_contested, session.has_answered});
}

void Lifecycle::expel(ClientSession& session, const std::string& why, TimePoint now) {
  report_presence(session, Presence::offline, now);
  forget(session, why, now);
}

void Lifecycle::forget(ClientSession& session, const std::string& why, TimePoint now) {
  subscriptions_.drop_all(session);
  clean(session, why, now);
  if (session.note_hash != 0) output_.emit(NoteChanged{Mesh::thread, session.robot, {}});
  erase(session);
}

std::vector<WaitingMessage> Lifecycle::give_up(ClientSession& session, TimePoint now) {
  std::vector<WaitingMessage> unsent = downlink_.take_unsent(session, now);
  clean(session, "", now);
  erase(session);
  return unsent;
}

void Lifecycle::erase(ClientSession& session) {
  output_.mark_changed(session);
  clients_.erase(session);
}

void Lifecycle::leave(ClientSession& session, ClientState state, TimePoint now) {
  constexpr const char* why = "the robot is not connected";
  session.answers.clear();
  downlink_.rest(session);
  enter(session, state, now);
  if (session.is_clean) {
    downlink_.drop_all(session, why, now);
  } else {
    downlink_.drop_volatile(session, why, now);
  }
  output_.mark_changed(session);
}

void Sleep::fall_asleep(ClientSession& session, std::chrono::seconds duration, TimePoint now) {
  session.sleep_duration = duration;
  if (session.delivery.forgets_ids_asleep) session.topics.forget_known();
  downlink_.rest(session);
  lifecycle_.enter(session, ClientState::asleep, now);
  output_.mark_changed(session);
}

void Sleep::wake(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::asleep) return;
  lifecycle_.enter(session, ClientState::awake, now);
  session.delivery.wake_budget = session.delivery.queue.size() + settings_.max_sleeping_messages;
}

void Sleep::follow(ClientSession& session, const Peer& peer, const LocalAddress& local,
                   TimePoint now) {
  if (ClientSession* former = clients_.find(peer)) lifecycle_.displace(*former, now);
  const bool is_new_address = session.peer != peer;
  clients_.bind(session, peer, local);
  if (is_new_address) downlink_.on_address(session);
  output_.mark_changed(session);
  lifecycle_.report_presence(session, presence_of(session.state()), now);
}

void Sleep::settle(ClientSession& session, TimePoint now) {
  if (session.state() != ClientState::awake || !session.answers.empty()) return;
  if (downlink_.is_awaiting(session)) return;
  output_.send(session, Pingresp{});
  sleep_again(session, now);
}

/// No PINGRESP: a client that does not answer may not listen any longer.
void Sleep::on_unanswered(ClientSession& session, TimePoint now) {
  if (session.state() == ClientState::awake) sleep_again(session, now);
}

void Sleep::sleep_again(ClientSession& session, TimePoint now) {
  downlink_.rest(session);
  lifecycle_.enter(session, ClientState::asleep, now);
}

std::optional<TimePoint> Supervision::deadline() const {
  return earlier(clients_.earliest(), commands_.deadline());
}

void Supervision::on_deadline(TimePoint now) {
  expire_commands(now);
  while (ClientSession* session = clients_.pop_due(now)) on_time(*session, now);
}

void Supervision::on_time(ClientSession& session, TimePoint now) {
  const auto lost = lost_at(session);
  if (lost && *lost <= now) return lifecycle_.lose(session, now);
  if (downlink_.on_time(session, now)) sleep_.on_unanswered(session, now);
  advance(session, now);
}

void Supervision::advance(ClientSession& session, TimePoint now) {
  downlink_.pump(session, now);
  sleep_.settle(session, now);
  if (const auto next = earlier(lost_at(session), downlink_.next_time(session)))
    clients_.wake_by(session, *next);
}

void Supervision::expire_commands(TimePoint now) {
  std::vector<ClientSession*> waiting;  // nothing is sent before all are withdrawn
  while (const auto command = commands_.pop_overdue(now)) {
    ClientSession* session = clients_.find(command->client_id);
    std::string why = session ? downlink_.withdraw(*session, *command) : "the robot has gone";
    commands_.end(command, CommandResult::timeout, std::move(why), now);
    if (session) waiting.push_back(session);
  }
  for (ClientSession* session : waiting) advance(*session, now);
}

/// An awake client is supervised by the repetitions of what it is sent.
std::optional<TimePoint> Supervision::lost_at(const ClientSession& session) const {
  std::chrono::seconds duration{0};
  switch (session.state()) {
    case ClientState::active: duration = session.keep_alive; break;
    case ClientState::asleep: duration = session.sleep_duration; break;
    case ClientState::awake:
    case ClientState::disconnected:
    case ClientState::lost: return std::nullopt;
  }
  if (duration.count() == 0) duration = limits::max_supervision;
  const std::chrono::duration<double> allowed = duration * settings_.keep_alive_tolerance;
  return session.last_heard + std::chrono::duration_cast<Duration>(allowed);
}

}  // namespace slamgw::mqttsn
