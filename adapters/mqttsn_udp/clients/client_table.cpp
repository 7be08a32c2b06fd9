// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/client_table.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

/// Names the network when no address in it has half of its clients.
MeshPlaces::Crowd name_crowd(const std::pair<IpAddress, std::size_t>& at_address,
                             const std::pair<IpAddress, std::size_t>& in_network) {
  if (at_address.second == 0) return {};
  if (2 * at_address.second < in_network.second)
    return {to_string(in_network.first) + "/64", in_network.second};
  return {to_string(at_address.first), at_address.second};
}

}  // namespace

void Unanswered::add(const IpAddress& group, ClientSession& session) {
  std::set<ClientSession*>& members = groups_[group];
  by_size_.erase({members.size(), group});
  members.insert(&session);
  by_size_.emplace(members.size(), group);
}

void Unanswered::remove(const IpAddress& group, ClientSession& session) {
  const auto found = groups_.find(group);
  if (found == groups_.end() || !found->second.contains(&session)) return;
  by_size_.erase({found->second.size(), group});
  found->second.erase(&session);
  if (found->second.empty()) {
    groups_.erase(found);
  } else {
    by_size_.emplace(found->second.size(), group);
  }
}

bool Unanswered::has_fuller(const IpAddress& own) const {
  return largest().second >= size_of(own) + 2;
}

std::vector<ClientSession*> Unanswered::fullest(const IpAddress& own) const {
  if (!has_fuller(own)) return {};
  const std::size_t few = size_of(own);
  const std::set<ClientSession*>& most = groups_.at(by_size_.rbegin()->second);
  std::vector<ClientSession*> chosen(std::min(limits::crowd_step, (most.size() - few) / 2));
  std::ranges::partial_sort_copy(most, chosen, {}, &ClientSession::last_heard,
                                 &ClientSession::last_heard);
  return chosen;
}

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

bool ClientTable::bind(ClientSession& session, const Peer& peer, const LocalAddress& local) {
  session.local = local;
  if (session.peer == peer) return false;
  unbind(session);
  if (ClientSession* former = find(peer)) unbind(*former);
  by_peer_[peer] = &session;
  session.peer = peer;
  set_in_crowd(session, true);
  if (!peer.identity.empty()) set_answered(session);
  return true;
}

void ClientTable::unbind(ClientSession& session) {
  if (session.peer) by_peer_.erase(*session.peer);
  set_in_crowd(session, false);
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
  auto& queue = session.is_connected() ? silent_ : gone_;
  queue.arm_by(session.evictable_armed, &session, at);
}

void ClientTable::set_needed(ClientSession& session) {
  std::optional<TimePoint> in_other = session.evictable_armed;
  gone_.disarm(in_other, &session);
  silent_.disarm(session.evictable_armed, &session);
}

ClientSession* ClientTable::take_evictable(TimePoint now) {
  auto found = gone_.pop_due(now);
  if (!found) found = silent_.pop_due(now);
  if (!found) return nullptr;
  (*found)->evictable_armed.reset();
  return *found;
}

bool ClientTable::has_room(const Peer& peer, TimePoint now) const {
  const auto is_due = [now](std::optional<TimePoint> at) { return at && *at <= now; };
  const IpAddress& own = peer.endpoint.address;
  return !is_full() || is_due(gone_.earliest()) || is_due(silent_.earliest()) ||
         by_address_.has_fuller(own) || by_network_.has_fuller(network_of(own));
}

void ClientTable::set_answered(ClientSession& session) {
  if (session.has_answered) return;
  set_in_crowd(session, false);
  if (session.is_connected()) set_needed(session);
  session.has_answered = true;
  ++answered_;
}

std::vector<ClientSession*> ClientTable::crowd(const Peer& peer) const {
  const IpAddress& own = peer.endpoint.address;
  std::vector<ClientSession*> of_address = by_address_.fullest(own);
  return of_address.empty() ? by_network_.fullest(network_of(own)) : of_address;
}

MeshPlaces::Crowd ClientTable::largest_crowd() const {
  std::map<IpAddress, std::size_t> addresses;
  std::map<IpAddress, std::size_t> networks;
  for (const auto& [id, session] : by_id_) {
    if (!session->peer) continue;
    ++addresses[session->peer->endpoint.address];
    ++networks[network_of(session->peer->endpoint.address)];
  }
  if (addresses.empty()) return {};
  const auto size = [](const auto& group) { return group.second; };
  return name_crowd(*std::ranges::max_element(addresses, {}, size),
                    *std::ranges::max_element(networks, {}, size));
}

MeshPlaces::Crowd ClientTable::largest_unanswered_crowd() const {
  return name_crowd(by_address_.largest(), by_network_.largest());
}

void ClientTable::set_in_crowd(ClientSession& session, bool is_in) {
  if (session.has_answered || !session.peer) return;
  const IpAddress& address = session.peer->endpoint.address;
  if (is_in) {
    by_address_.add(address, session);
    by_network_.add(network_of(address), session);
  } else {
    by_address_.remove(address, session);
    by_network_.remove(network_of(address), session);
  }
}

}  // namespace slamgw::mqttsn
