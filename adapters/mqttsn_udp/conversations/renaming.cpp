// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/renaming.hpp"

#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"

namespace slamgw::mqttsn {

/// All former names are left before new ones are taken: robots may swap theirs.
void Renaming::on_names(TimePoint now) {
  std::vector<ClientSession*> gone;
  std::vector<Renamed> renamed;
  for (const auto& [id, session] : clients_.all()) {
    if (rules_.names.of_client(id) == session->robot) continue;
    if (auto robot = connecting_.robot_of(id)) {
      renamed.push_back({session.get(), std::move(*robot)});
    } else {
      gone.push_back(session.get());
    }
  }
  for (ClientSession* session : gone) {
    if (session->is_connected()) output_.send(*session, Disconnect{});
    lifecycle_.expel(*session, "another robot has this name now", now);
  }
  for (const Renamed& one : renamed) leave_name(*one.session, now);
  for (const Renamed& one : renamed) enter_name(one, now);
}

void Renaming::leave_name(ClientSession& session, TimePoint now) {
  if (session.reported_presence) lifecycle_.report_presence(session, Presence::offline, now);
  subscriptions_.suspend(session);
  if (std::exchange(session.note_hash, 0) != 0)
    output_.emit(NoteChanged{Mesh::thread, session.robot, {}});
}

void Renaming::enter_name(const Renamed& renamed, TimePoint now) {
  ClientSession& session = *renamed.session;
  rename_topics(rules_.policy.scheme(), session, session.robot, renamed.robot);
  clients_.rename(session, renamed.robot);
  subscriptions_.resume(session, now);
  if (std::exchange(session.reported_presence, std::nullopt))
    lifecycle_.report_presence(session, presence_of(session.state()), now);
  output_.mark_changed(session);
}

}  // namespace slamgw::mqttsn
