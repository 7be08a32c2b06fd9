// SPDX-License-Identifier: Apache-2.0
// Answers on which a client relies, such as CONNACK and REGACK. Each waits until the client's
// session is saved, so that the client is known after a crash. Later datagrams to the same address
// wait behind it. Answers that come together share a save, and one save is under way at a time.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

namespace slamgw::mqttsn {

/// The clients whose sessions have changed or ended since they were last written to disk.
class ChangedSessions {
 public:
  explicit ChangedSessions(std::size_t max_clients) : max_clients_(max_clients) {}

  /// Call when something has changed that must survive a restart.
  void mark(const ClientSession& session);
  void unmark(const std::string& client_id) { client_ids_.erase(client_id); }
  bool has(const ClientSession& session) const { return client_ids_.contains(session.client_id); }
  bool has_any() const { return !client_ids_.empty(); }
  /// Returns and unmarks at most `max` client ids.
  std::vector<std::string> take(std::size_t max);

 private:
  std::size_t max_clients_;
  std::set<std::string> client_ids_;  // at most max_clients_ and limits::max_changed more
};

class UnsavedAnswers {
 public:
  /// Call once when there is a store. Nothing waits before.
  void begin() { is_waiting_ = true; }

  /// Takes the datagram and returns true if it has to wait. `client_id`: the client whose session
  /// must be saved first; null if the datagram only keeps its place behind such answers.
  bool take(SendDatagram& datagram, const std::string* client_id);
  bool empty() const { return batches_.empty(); }
  bool is_full() const;

  /// Begins a save and returns the clients to save. Empty while a save is under way.
  std::set<std::string> begin_save();
  /// Call when the save has succeeded. Returns the datagrams that waited for it; answers wait from
  /// now on.
  std::vector<SendDatagram> on_saved();
  /// Returns all datagrams, without a save. Nothing waits until the next on_saved().
  std::vector<SendDatagram> give_up();

 private:
  struct Batch {
    std::set<std::string> client_ids;
    std::vector<SendDatagram> datagrams;
  };

  std::vector<SendDatagram> take_first();

  bool is_waiting_ = false;
  bool is_saving_ = false;                     // a save of the first batch is under way
  std::deque<Batch> batches_;                  // in the order of their saves
  std::uint64_t first_ = 0;                    // the number of the first batch
  std::size_t waiting_ = 0;                    // datagrams
  std::map<Endpoint, std::uint64_t> last_of_;  // batch of the last datagram to an address
};

}  // namespace slamgw::mqttsn
