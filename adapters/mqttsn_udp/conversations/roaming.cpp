// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/roaming.hpp"

#include <algorithm>
#include <iterator>
#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

bool Roaming::takes(const Arrival& arrival, const Connect& connect) {
  if (!rules_.may_speak(connect.client_id, arrival.peer)) return false;
  const auto waiting = std::ranges::find_if(waiting_, [&](const WaitingConnect& each) {
    return each.arrival.peer == arrival.peer || each.connect.client_id == connect.client_id;
  });
  if (waiting != waiting_.end()) {
    if (waiting->connect.client_id != connect.client_id) return true;
    waiting->connect = connect;  // it may want a clean session now
    waiting->arrival = arrival;
    return true;
  }
  if (connect.clean_session || waiting_.size() >= limits::max_waiting_connects ||
      clients_.find(connect.client_id))
    return false;
  const auto robot = rules_.names.of_client(connect.client_id);
  if (!robot || !is_valid_level(*robot) || !served_elsewhere_(*robot)) return false;
  waiting_.push_back({arrival, connect, *robot, arrival.now + limits::note_patience});
  output_.emit(NoteRequest{Mesh::thread, *robot});
  return true;
}

bool Roaming::keep(const RobotMessage& message, TimePoint now) {
  const auto found = std::ranges::find(waiting_, message.robot, &WaitingConnect::robot);
  if (is_stopping_ || found == waiting_.end() ||
      found->messages.size() >= limits::max_queued_messages)
    return false;
  found->messages.emplace_back(now, message);
  return true;
}

std::vector<RobotMessage> Roaming::on_stop(TimePoint now) {
  is_stopping_ = true;
  std::vector<RobotMessage> unsent;
  for (WaitingConnect& waited : waiting_)
    std::ranges::move(waited.take_messages(now), std::back_inserter(unsent));
  return unsent;
}

bool Roaming::is_waiting(const std::string& robot) const {
  return std::ranges::find(waiting_, robot, &WaitingConnect::robot) != waiting_.end();
}

std::vector<RobotMessage> Roaming::WaitingConnect::take_messages(TimePoint now) {
  std::vector<RobotMessage> taken;
  for (auto& [came, message] : std::exchange(messages, {})) {
    message.message.waited += std::chrono::duration_cast<Waited>(now - came);
    taken.push_back(std::move(message));
  }
  return taken;
}

std::optional<Roaming::WaitingConnect> Roaming::take(const std::string& robot) {
  const auto found = std::ranges::find(waiting_, robot, &WaitingConnect::robot);
  if (found == waiting_.end()) return std::nullopt;
  WaitingConnect connect = std::move(*found);
  waiting_.erase(found);
  return connect;
}

std::optional<Roaming::WaitingConnect> Roaming::take_overdue(TimePoint now) {
  if (waiting_.empty() || waiting_.front().until > now) return std::nullopt;
  return take(waiting_.front().robot);
}

std::optional<TimePoint> Roaming::deadline() const {
  if (waiting_.empty()) return std::nullopt;
  return waiting_.front().until;
}

/// Returns a time in the past after a change: the note is written in the next turn of the loop.
std::optional<TimePoint> Notes::deadline() const {
  if (!output_.has_noteworthy()) return std::nullopt;
  return TimePoint{};
}

void Notes::on_deadline(TimePoint now) {
  for (const std::string& id : output_.take_noteworthy(limits::notes_a_turn)) {
    if (ClientSession* session = clients_.find(id)) update(*session, now);
  }
}

void Notes::update(ClientSession& session, TimePoint now) {
  if (session.dropped_before_note) return;
  const SessionSnapshot content = to_note(to_snapshot(session, now));
  const bool is_empty =
      session.is_clean && !content.will && content.topics.empty() && content.subscriptions.empty();
  Bytes note = is_empty ? Bytes{} : encode_session(content);
  if (note.size() > limits::max_note_octets) note.clear();  // none is better than an old one
  const std::uint64_t hash = note.empty() ? 0 : fingerprint(note);
  if (std::exchange(session.note_hash, hash) == hash) return;
  output_.emit(NoteChanged{Mesh::thread, session.robot, std::move(note)});
}

std::optional<SessionSnapshot> Restoring::snapshot(const std::string& client_id,
                                                   TimePoint now) const {
  const ClientSession* session = clients_.find(client_id);
  if (!session) return std::nullopt;
  SessionSnapshot out = to_snapshot(*session, now);
  out.is_validated = output_.is_validated(*session);
  if (!out.is_validated)
    out.allowance = output_.validation.allowance(session->peer->endpoint.address);
  return out;
}

void Restoring::refuse_commands(const SessionSnapshot& snapshot, TimePoint now) {
  for (const MessageSnapshot& message : snapshot.messages) {
    downlink_.end_command(command_of(message, snapshot, now), CommandResult::refused,
                          "the robot's session can't be restored", now);
  }
}

bool Restoring::restore(const SessionSnapshot& snapshot, TimePoint now) {
  const auto robot = rules_.robot_of(snapshot.client_id);
  const bool is_elsewhere =
      snapshot.peer &&
      !rules_.names.may_come_from(snapshot.client_id, snapshot.peer->endpoint.address);
  if (!robot || is_elsewhere || !is_valid_level(snapshot.robot) || clients_.is_full() ||
      clients_.find(snapshot.client_id)) {
    refuse_commands(snapshot, now);
    return false;
  }
  ClientSession& session = clients_.create(snapshot.client_id, *robot);
  if (snapshot.has_answered) clients_.set_answered(session);
  apply(snapshot, session, now);
  if (*robot != snapshot.robot)
    rename_topics(rules_.policy.scheme(), session, snapshot.robot, *robot);
  if (snapshot.peer) {
    const IpAddress& address = snapshot.peer->endpoint.address;
    if (snapshot.is_validated) output_.validation.validate(address);
    output_.validation.restore_allowance(address, snapshot.allowance);
    if (clients_.bind(session, *snapshot.peer, session.local)) downlink_.on_address(session);
  }
  session.note_hash = unknown_note_hash;
  subscriptions_.restore(session, *robot == snapshot.robot, now);
  lifecycle_.enter(session, snapshot.state, now);
  if (snapshot.peer && !rules_.may_speak(snapshot.client_id, *snapshot.peer)) {
    clients_.wake_by(session, now);  // its commands have a deadline
    lifecycle_.displace(session, now);
  } else {
    supervision_.advance(session, now);
  }
  return true;
}

void Restoring::complete(ClientSession& session, const std::optional<SessionSnapshot>& note,
                         TimePoint now) {
  const auto dropped = std::exchange(session.dropped_before_note, nullptr);
  output_.mark_changed(session);
  if (!note) return;
  for (const TopicTable::Topic& topic : note->topics) session.topics.restore(topic);
  if (!session.will && note->will) session.will = std::make_unique<Will>(*note->will);
  subscriptions_.add_noted(session, note->subscriptions, *dropped, now);
}

/// Leaves all former names before it takes new ones, because robots may swap names.
void Renaming::on_names(TimePoint now) {
  std::vector<ClientSession*> gone;
  std::vector<ClientSession*> unproven;  // their keys have come
  std::vector<Renamed> renamed;
  for (const auto& [id, session] : clients_.all()) {
    const auto& peer = session->peer;
    // Without its key, anyone could use the client id over plain UDP, and collect its messages.
    const bool is_key_gone =
        peer && !peer->identity.empty() && !rules_.identities.contains(peer->identity);
    const bool is_shut_out = peer && (rules_.names.bans().covers(peer->endpoint.address) ||
                                      !rules_.names.may_come_from(id, peer->endpoint.address));
    if (is_key_gone || is_shut_out) {
      gone.push_back(session.get());
      continue;
    }
    if (rules_.names.of_client(id) != session->robot) {
      auto robot = rules_.robot_of(id);
      if (!robot) {
        gone.push_back(session.get());
        continue;
      }
      renamed.push_back({session.get(), std::move(*robot)});
    }
    if (peer && !rules_.may_speak(id, *peer)) unproven.push_back(session.get());
  }
  for (ClientSession* session : gone) {
    if (session->is_connected()) output_.send(*session, Disconnect{});
    lifecycle_.expel(*session,
                     "the robot is banned, its key was removed, or its name or address now belongs "
                     "to another",
                     now);
  }
  for (const Renamed& one : renamed) leave_name(*one.session, now);
  for (const Renamed& one : renamed) enter_name(one, now);
  for (ClientSession* session : unproven) lifecycle_.displace(*session, now);
}

void Renaming::leave_name(ClientSession& session, TimePoint now) {
  if (session.reported_presence) lifecycle_.report_presence(session, Presence::offline, now);
  const auto kept = session.subscriptions;
  subscriptions_.drop_all(session);  // the robot's new name asks for all filters
  session.subscriptions = kept;
  if (std::exchange(session.note_hash, 0) != 0)
    output_.emit(NoteChanged{Mesh::thread, session.robot, {}});
}

void Renaming::enter_name(const Renamed& renamed, TimePoint now) {
  ClientSession& session = *renamed.session;
  rename_topics(rules_.policy.scheme(), session, session.robot, renamed.robot);
  clients_.rename(session, renamed.robot);
  subscriptions_.restore(session, /*are_standing=*/false, now);
  if (std::exchange(session.reported_presence, std::nullopt))
    lifecycle_.report_presence(session, presence_of(session.state()), now);
  output_.mark_changed(session);
}

}  // namespace slamgw::mqttsn
