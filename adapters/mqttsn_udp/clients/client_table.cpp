// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/client_table.hpp"

namespace slamgw::mqttsn {

ClientSession* ClientTable::find(const std::string& client_id) const {
  const auto found = by_id_.find(client_id);
  return found == by_id_.end() ? nullptr : found->second.get();
}

ClientSession* ClientTable::find(const Peer& peer) const {
  const auto found = by_peer_.find(peer);
  return found == by_peer_.end() ? nullptr : found->second;
}

ClientSession* ClientTable::find_robot(const std::string& robot) const {
  const auto found = by_robot_.find(robot);
  return found == by_robot_.end() ? nullptr : found->second;
}

std::weak_ptr<ClientSession> ClientTable::weak(const ClientSession& session) const {
  return by_id_.at(session.client_id);
}

ClientSession& ClientTable::create(const std::string& client_id, const std::string& robot) {
  auto session = std::make_shared<ClientSession>();
  session->topics.number_by(topic_ids_);
  session->topics.charge(names_);
  session->client_id = client_id;
  session->robot = robot;
  by_robot_[robot] = session.get();
  return *(by_id_[client_id] = std::move(session));
}

void ClientTable::rename(ClientSession& session, const std::string& robot) {
  if (find_robot(session.robot) == &session) by_robot_.erase(session.robot);
  session.robot = robot;
  by_robot_[robot] = &session;
}

void ClientTable::erase(ClientSession& session) {
  unbind(session);
  timers_.disarm(session.timer_armed, &session);
  set_needed(session);
  by_robot_.erase(session.robot);
  by_id_.erase(session.client_id);
}

void ClientTable::bind(ClientSession& session, const Peer& peer, const LocalAddress& local) {
  session.local = local;
  if (session.peer == peer) return;
  unbind(session);
  if (ClientSession* former = find(peer)) unbind(*former);
  by_peer_[peer] = &session;
  session.peer = peer;
}

void ClientTable::unbind(ClientSession& session) {
  if (session.peer) by_peer_.erase(*session.peer);
  session.peer.reset();
}

void ClientTable::wake_by(ClientSession& session, TimePoint at) {
  timers_.arm_by(session.timer_armed, &session, at);
}

ClientSession* ClientTable::pop_due(TimePoint now) {
  const auto due = timers_.pop_due(now);
  if (!due) return nullptr;
  (*due)->timer_armed.reset();
  return *due;
}

void ClientTable::set_evictable(ClientSession& session, TimePoint at) {
  set_needed(session);
  evictable_.arm_by(session.evictable_armed, &session, at);
}

void ClientTable::set_needed(ClientSession& session) {
  evictable_.disarm(session.evictable_armed, &session);
}

ClientSession* ClientTable::evictable(TimePoint now) {
  const auto longest_gone = evictable_.pop_due(now);
  if (!longest_gone) return nullptr;
  (*longest_gone)->evictable_armed.reset();
  return *longest_gone;
}

bool ClientTable::has_room(TimePoint now) const {
  return !is_full() || (evictable_.earliest() && *evictable_.earliest() <= now);
}

}  // namespace slamgw::mqttsn
