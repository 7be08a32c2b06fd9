// SPDX-License-Identifier: Apache-2.0
// The sessions, found by client id, by transport address and by robot. Ids are compared whole.
// Makes room by forgetting who has been gone longest; changes nothing else in a session than its
// binding.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>

#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "adapters/mqttsn_udp/clients/timer_queue.hpp"

namespace slamgw::mqttsn {

class ClientTable {
 public:
  explicit ClientTable(std::size_t max_clients, TopicIdOf topic_ids = topic_id_of)
      : max_clients_(max_clients), topic_ids_(topic_ids) {}

  ClientSession* find(const std::string& client_id) const;
  ClientSession* find(const Peer& peer) const;
  ClientSession* find_robot(const std::string& robot) const;
  std::weak_ptr<ClientSession> weak(const ClientSession& session) const;

  /// All sessions' names are charged to it.
  NameBudget& names() { return names_; }

  bool is_full() const { return by_id_.size() >= max_clients_; }
  std::size_t size() const { return by_id_.size(); }
  ClientSession& create(const std::string& client_id, const std::string& robot);
  /// Two sessions may swap their names, one after the other.
  void rename(ClientSession& session, const std::string& robot);
  /// The session ends here: `session` dangles afterwards.
  void erase(ClientSession& session);

  /// From now on datagrams of `peer` are this client's; its former address is a stranger's (R36).
  void bind(ClientSession& session, const Peer& peer, const LocalAddress& local);
  void unbind(ClientSession& session);

  /// Looks at the session at `at`, or before.
  void wake_by(ClientSession& session, TimePoint at);
  std::optional<TimePoint> earliest() const { return timers_.earliest(); }
  ClientSession* pop_due(TimePoint now);

  /// May be forgotten from `at` on when there is no room for others.
  void set_evictable(ClientSession& session, TimePoint at);
  void set_needed(ClientSession& session);
  ClientSession* evictable(TimePoint now);
  bool has_room(TimePoint now) const;

  const std::unordered_map<std::string, std::shared_ptr<ClientSession>>& all() const {
    return by_id_;
  }

 private:
  std::size_t max_clients_;
  TopicIdOf topic_ids_;
  NameBudget names_;  // outlives the sessions
  std::unordered_map<std::string, std::shared_ptr<ClientSession>> by_id_;
  std::unordered_map<Peer, ClientSession*, PeerHash> by_peer_;
  std::unordered_map<std::string, ClientSession*> by_robot_;
  TimerQueue<ClientSession*> timers_;
  TimerQueue<ClientSession*> evictable_;
};

}  // namespace slamgw::mqttsn
