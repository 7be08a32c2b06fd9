// SPDX-License-Identifier: Apache-2.0
// The sessions, found by client id, by transport address and by robot. Ids are compared whole.
// Chooses the sessions that may be forgotten to make room. In a session it changes only the
// binding, the robot's name, and the marks for its own queues.
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
// owner has at most one entry and keeps its time (`armed`), so no stale entry stays.

template <class Key>
class TimerQueue {
 public:
  /// Makes the key due at `at` or earlier. An earlier entry stays; its owner checks again then.
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

  /// Removes and returns the first key that is due; its owner must reset `armed`.
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
  /// Returns some clients of the fullest group, the longest silent first, if that group has at
  /// least two more members than `own`.
  std::vector<ClientSession*> fullest(const IpAddress& own) const;
  /// Returns true if fullest(own) returns clients. Cheap.
  bool has_fuller(const IpAddress& own) const;
  /// Returns the fullest group and its size; the size is 0 when there is none.
  std::pair<IpAddress, std::size_t> largest() const {
    if (by_size_.empty()) return {};
    return {by_size_.rbegin()->second, by_size_.rbegin()->first};
  }

 private:
  std::size_t size_of(const IpAddress& group) const {
    const auto found = groups_.find(group);
    return found == groups_.end() ? 0 : found->second.size();
  }

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

  /// The budget to which the names of all sessions are charged.
  NameBudget& names() { return names_; }

  bool is_full() const { return by_id_.size() >= max_clients_; }
  std::size_t size() const { return by_id_.size(); }
  ClientSession& create(const std::string& client_id, const std::string& robot);
  /// Gives the session's robot another name. Two sessions may swap names, one after the other.
  void rename(ClientSession& session, const std::string& robot);
  /// Ends the session: `session` dangles afterwards.
  void erase(ClientSession& session);

  /// Makes datagrams of `peer` this client's; its former address becomes a stranger's (R36). A DTLS
  /// handshake counts as an answer. Returns false if the client had this address before.
  bool bind(ClientSession& session, const Peer& peer, const LocalAddress& local);
  void unbind(ClientSession& session);

  /// Makes pop_due() return the session at `at` or earlier.
  void wake_by(ClientSession& session, TimePoint at);
  std::optional<TimePoint> earliest() const { return timers_.earliest(); }
  ClientSession* pop_due(TimePoint now);

  /// Lets take_evictable() return the session from `at` on.
  void set_evictable(ClientSession& session, TimePoint at);
  /// Undoes set_evictable().
  void set_needed(ClientSession& session);
  /// Returns a session to forget when room is needed: of the client that has gone first, else of
  /// one that only connected. Null if none is evictable.
  ClientSession* take_evictable(TimePoint now);
  /// Whether a new client at `peer` may find a place; make_room() of Lifecycle decides.
  bool has_room(const Peer& peer, TimePoint now) const;
  void set_answered(ClientSession& session);
  std::size_t unanswered() const { return size() - answered_; }
  /// Returns the address, or else the network (`fd00::/64`), that has most clients. Looks at all
  /// clients.
  MeshPlaces::Crowd largest_crowd() const;
  /// Returns the same for the clients that have not answered. Cheap.
  MeshPlaces::Crowd largest_unanswered_crowd() const;
  /// Returns clients that lose their places to `peer` when no session is evictable. None of them
  /// has answered yet: the longest silent clients of one address or /64, which must have at least
  /// two more than that of `peer`. At most limits::crowd_step. Cheap when the result is empty,
  /// because an attacker can cause many calls.
  std::vector<ClientSession*> crowd(const Peer& peer) const;

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
  TimerQueue<ClientSession*> gone_;    // when clients that have gone are evictable
  TimerQueue<ClientSession*> silent_;  // when clients that only connected are
  Unanswered by_address_;
  Unanswered by_network_;
};

/// Returns the table of `slam-gatewayctl mqttsn clients`: a row for each client, sorted by robot.
/// With `robot`, only its row (none if it is unknown), with its topics, subscriptions and the
/// topics of its waiting messages. `longest_wait`: `mqttsn.retry_interval_s`.
nlohmann::json client_report(const ClientTable& clients, const std::optional<std::string>& robot,
                             Duration longest_wait, TimePoint now);

}  // namespace slamgw::mqttsn
