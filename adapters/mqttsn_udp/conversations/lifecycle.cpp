// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"

#include <fmt/format.h>

#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void Lifecycle::on_heard(ClientSession& session, TimePoint now) {
  note_heard(session, now);
  if (session.is_connected()) clients_.set_needed(session);  // it does more than connect
  if (now - session.sign_of_life_reported < limits::sign_of_life_interval) return;
  session.sign_of_life_reported = now;
  output_.emit(SignOfLife{Mesh::thread, session.robot});
  if (session.reported_contested && session.reported_presence)
    report_presence(session, *session.reported_presence, now);
}

void Lifecycle::note_heard(ClientSession& session, TimePoint now) {
  session.last_heard = now;
  session.connect_fingerprint = 0;
  downlink_.on_heard(session);
}

void Lifecycle::enter(ClientSession& session, ClientState state, TimePoint now) {
  session.state_ = state;
  switch (state) {
    case ClientState::active: session.sleep_duration = {}; [[fallthrough]];
    case ClientState::asleep:
      session.last_heard = now;
      clients_.set_needed(session);
      [[fallthrough]];
    case ClientState::awake: return report_presence(session, presence_of(state), now);
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
  const bool was_asleep = session.sleep_duration.count() > 0;
  enter(session, was_asleep ? ClientState::asleep : ClientState::active, now);
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
  session.dropped_before_note.reset();
  subscriptions_.forget_all(session);
  session.will.reset();
  session.topics.clear();
  session.repeats.clear();  // MsgIds start again
  downlink_.drop_all(session, why, now);
}

bool Lifecycle::make_room(const Peer& peer, TimePoint now) {
  while (clients_.is_full()) {
    ClientSession* gone = clients_.take_evictable(now);
    if (!gone) break;
    evict(*gone, now);
  }
  if (!clients_.is_full()) return true;
  const std::vector<ClientSession*> crowd = clients_.crowd(peer);
  for (ClientSession* session : crowd) evict(*session, now);
  return !crowd.empty();
}

/// Forgets the session. Of a client that has not answered, its presence and its session at the
/// broker are forgotten, too.
void Lifecycle::evict(ClientSession& session, TimePoint now) {
  output_.count(Count::clients_evicted);
  if (session.is_connected() && session.peer) {
    if (crowd_lines_.on_event(now))
      output_.emit(Notice{
          Severity::warning,
          fmt::format("mqttsn.max_clients ({}) is reached; clients that have not shown that they "
                      "receive lose their places, first '{}' at {}",
                      settings_.max_clients, session.client_id, to_string(*session.peer)),
          {}});
    output_.send(session, Disconnect{});
  }
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
  if (const auto next = downlink_.next_time(session)) clients_.wake_by(session, *next);
}

}  // namespace slamgw::mqttsn
