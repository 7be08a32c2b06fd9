// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/restoring.hpp"

#include "adapters/mqttsn_udp/conversations/own_names.hpp"

namespace slamgw::mqttsn {

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

void Restoring::adopt_commands(const Delivery& delivery) {
  for (const Outgoing& waiting : delivery.queue) {
    if (waiting.command) commands_.adopt(waiting.command);
  }
}

void Restoring::refuse_commands(const SessionSnapshot& snapshot, TimePoint now) {
  for (const MessageSnapshot& message : snapshot.messages) {
    commands_.end(command_of(message, snapshot, now), CommandResult::refused,
                  "the robot's session can't go on", now);
  }
}

bool Restoring::restore(const SessionSnapshot& snapshot, TimePoint now) {
  const auto robot = connecting_.robot_of(snapshot.client_id);
  if (!robot || !is_valid_level(snapshot.robot) || clients_.is_full() ||
      clients_.find(snapshot.client_id)) {
    refuse_commands(snapshot, now);
    return false;
  }
  ClientSession& session = clients_.create(snapshot.client_id, *robot);
  apply(snapshot, session, now);
  if (*robot != snapshot.robot)
    rename_topics(rules_.policy.scheme(), session, snapshot.robot, *robot);
  adopt_commands(session.delivery);
  if (snapshot.peer) {
    const IpAddress& address = snapshot.peer->endpoint.address;
    if (snapshot.is_validated) output_.validation.validate(address);
    output_.validation.restore_allowance(address, snapshot.allowance);
    clients_.bind(session, *snapshot.peer, session.local);
    downlink_.on_address(session);
  }
  if (!snapshot.is_clean) session.note_hash = unknown_note_hash;
  subscriptions_.restore(session, *robot == snapshot.robot, now);
  lifecycle_.enter(session, snapshot.state, now);
  supervision_.expire_commands(now);
  supervision_.advance(session, now);
  return true;
}

}  // namespace slamgw::mqttsn
