// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/client_table.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

IpAddress network_of(IpAddress address) {
  if (!is_ipv4(address)) std::fill(address.begin() + 8, address.end(), std::uint8_t{0});
  return address;
}

void keep_longest_silent(std::vector<ClientSession*>& sessions, std::size_t count) {
  if (sessions.size() <= count) return;
  std::ranges::nth_element(sessions, sessions.begin() + static_cast<std::ptrdiff_t>(count), {},
                           &ClientSession::last_heard);
  sessions.resize(count);
}

/// Of the fullest group, when it has at least two more than the group of `own`.
std::vector<ClientSession*> fullest(std::map<IpAddress, std::vector<ClientSession*>>& groups,
                                    const IpAddress& own) {
  const auto size = [](const auto& group) { return group.second.size(); };
  const auto most = std::ranges::max_element(groups, {}, size);
  const auto ours = groups.find(own);
  const std::size_t few = ours == groups.end() ? 0 : ours->second.size();
  if (most == groups.end() || most->second.size() < few + 2) return {};
  keep_longest_silent(most->second, std::min(limits::crowd_step, (most->second.size() - few) / 2));
  return std::move(most->second);
}

}  // namespace

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
  if (session.has_answered) --answered_;
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
  return !is_full() || (evictable_.earliest() && *evictable_.earliest() <= now) || unanswered() > 1;
}

void ClientTable::set_answered(ClientSession& session) {
  if (!std::exchange(session.has_answered, true)) ++answered_;
}

std::vector<ClientSession*> ClientTable::crowd(const Peer& peer, TimePoint now) const {
  std::vector<ClientSession*> silent;
  std::map<IpAddress, std::vector<ClientSession*>> addresses;
  std::map<IpAddress, std::vector<ClientSession*>> networks;
  for (const auto& [id, session] : by_id_) {
    if (session->has_answered || !session->peer) continue;
    const bool has_only_connected = session->connect_fingerprint != 0;
    if (has_only_connected && now - session->connected_at >= limits::crowd_patience)
      silent.push_back(session.get());
    const IpAddress& address = session->peer->endpoint.address;
    addresses[address].push_back(session.get());
    networks[network_of(address)].push_back(session.get());
  }
  keep_longest_silent(silent, limits::crowd_step);
  if (!silent.empty()) return silent;
  const IpAddress& own = peer.endpoint.address;
  std::vector<ClientSession*> of_address = fullest(addresses, own);
  return of_address.empty() ? fullest(networks, network_of(own)) : of_address;
}

}  // namespace slamgw::mqttsn
