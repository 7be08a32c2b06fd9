// SPDX-License-Identifier: Apache-2.0
// The sessions, found by client id, by transport address and by robot. Ids are compared whole.
// Makes room by forgetting who has been gone longest; changes nothing else in a session than its
// binding.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

// Deadlines of many owners, ordered, so that neither a tick nor a message visits all clients. An
// owner has at most one entry and keeps its time (`armed`), so nothing stale stays behind.

template <class Key>
class TimerQueue {
 public:
  /// Fires at `at` or before: an entry that is already earlier stays, its owner checks again then.
  void arm_by(std::optional<TimePoint>& armed, const Key& key, TimePoint at) {
    if (armed && *armed <= at) return;
    disarm(armed, key);
    entries_.emplace(at, key);
    armed = at;
  }

  void disarm(std::optional<TimePoint>& armed, const Key& key) {
    if (armed) entries_.erase({*armed, key});
    armed.reset();
  }

  std::optional<TimePoint> earliest() const {
    if (entries_.empty()) return std::nullopt;
    return entries_.begin()->first;
  }

  /// The first key that is due, taken out; its owner resets `armed`.
  std::optional<Key> pop_due(TimePoint now) {
    if (entries_.empty() || entries_.begin()->first > now) return std::nullopt;
    Key key = entries_.begin()->second;
    entries_.erase(entries_.begin());
    return key;
  }

 private:
  std::set<std::pair<TimePoint, Key>> entries_;
};

/// Clients that have an address and have not answered yet, in groups by address or network.
class Unanswered {
 public:
  void add(const IpAddress& group, ClientSession& session);
  void remove(const IpAddress& group, ClientSession& session);
  /// Some of the fullest group, the longest silent first, when it has at least two more members
  /// than `own`.
  std::vector<ClientSession*> fullest(const IpAddress& own) const;
  /// The fullest group and its size; 0 when there is none.
  std::pair<IpAddress, std::size_t> largest() const {
    if (by_size_.empty()) return {};
    return {by_size_.rbegin()->second, by_size_.rbegin()->first};
  }

 private:
  std::map<IpAddress, std::set<ClientSession*>> groups_;
  std::set<std::pair<std::size_t, IpAddress>> by_size_;
};

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
  /// A DTLS handshake counts as an answer.
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
  void set_answered(ClientSession& session);
  /// Its CONNECT was accepted: from now on it is expected to say something more.
  void on_connected(ClientSession& session, TimePoint now);
  std::size_t unanswered() const { return size() - answered_; }
  /// Returns the address, or else the network (`fd00::/64`), that has most clients. Looks at all
  /// clients.
  MeshPlaces::Crowd largest_crowd() const;
  /// The same of the clients that have not answered; cheap.
  MeshPlaces::Crowd largest_unanswered_crowd() const;
  /// Who gives way to `peer` when nobody has left: clients that have not answered yet. First those
  /// that said nothing after their CONNECT; then those of the address, or the /64, that has at
  /// least two more of them than the one of `peer`. The longest silent come first; some at a time.
  /// Cheap when the result is empty, because an attacker can cause many calls.
  std::vector<ClientSession*> crowd(const Peer& peer, TimePoint now);

  const std::unordered_map<std::string, std::shared_ptr<ClientSession>>& all() const {
    return by_id_;
  }

 private:
  void set_in_crowd(ClientSession& session, bool is_in);

  std::size_t max_clients_;
  std::size_t answered_ = 0;  // sessions that have answered
  TopicIdOf topic_ids_;
  NameBudget names_;  // outlives the sessions
  std::unordered_map<std::string, std::shared_ptr<ClientSession>> by_id_;
  std::unordered_map<Peer, ClientSession*, PeerHash> by_peer_;
  std::unordered_map<std::string, ClientSession*> by_robot_;
  TimerQueue<ClientSession*> timers_;
  TimerQueue<ClientSession*> evictable_;
  TimerQueue<ClientSession*> words_;  // when those that only connected may have to give way
  Unanswered by_address_;
  Unanswered by_network_;
};

/// The table of `slam-gatewayctl mqttsn clients`: a row for each client, by robot. `robot`: a row
/// for that one alone, with its topics, subscriptions and the topics of the messages that wait for
/// it; no row when it is unknown. `longest_wait`: `mqttsn.retry_interval_s`.
nlohmann::json client_report(const ClientTable& clients, const std::optional<std::string>& robot,
                             Duration longest_wait, TimePoint now);

}  // namespace slamgw::mqttsn
