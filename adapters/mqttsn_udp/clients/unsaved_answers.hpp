// SPDX-License-Identifier: Apache-2.0
// Answers on which a client relies, as CONNACK and REGACK: each waits until the client's session is
// saved, so that the client is known after a crash. What is sent to the same address later waits
// behind them. Answers that come together share a save, and one save is under way at a time.
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
  /// Something that must survive a restart has changed.
  void mark(const ClientSession& session);
  void unmark(const std::string& client_id) { client_ids_.erase(client_id); }
  bool has(const ClientSession& session) const { return client_ids_.contains(session.client_id); }
  bool has_any() const { return !client_ids_.empty(); }
  /// Client ids, at most `max`; they are not marked any more.
  std::vector<std::string> take(std::size_t max);

 private:
  std::set<std::string> client_ids_;  // at most max_dirty
};

class UnsavedAnswers {
 public:
  /// Nothing waits before this is called: there is no store.
  void begin() { is_waiting_ = true; }

  /// True when the datagram was taken over, as it waits. `client_id`: whose session is to be saved
  /// before; null for what only keeps its place behind such answers.
  bool take(SendDatagram& datagram, const std::string* client_id);
  bool empty() const { return batches_.empty(); }
  bool is_full() const;

  /// The clients whose sessions are saved next. Empty while a save is under way.
  std::set<std::string> begin_save();
  /// The save is over. Returns what waited for it; answers wait from now on.
  std::vector<SendDatagram> on_saved();
  /// Nothing is saved for now: returns all that waits, and nothing waits until the next on_saved().
  std::vector<SendDatagram> give_up();

 private:
  struct Batch {
    std::set<std::string> client_ids;
    std::vector<SendDatagram> datagrams;
  };

  std::vector<SendDatagram> take_first();

  bool is_waiting_ = false;
  bool is_saving_ = false;                     // the first batch
  std::deque<Batch> batches_;                  // in the order of their saves
  std::uint64_t first_ = 0;                    // the number of the first batch
  std::size_t waiting_ = 0;                    // datagrams
  std::map<Endpoint, std::uint64_t> last_of_;  // batch of the last datagram to an address
};

}  // namespace slamgw::mqttsn
