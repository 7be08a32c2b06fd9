// SPDX-License-Identifier: Apache-2.0
// The output of the machine: datagrams within the allowance of each address, events, counters, and
// the sessions to save. Decides nothing about the protocol.
#pragma once

#include <array>
#include <cstdint>
#include <variant>

#include "adapters/mqttsn_udp/clients/address_validation.hpp"
#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "adapters/mqttsn_udp/clients/unsaved_answers.hpp"
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/operator_order.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::mqttsn {

// The machine's counters: one enumerator and one stable name each.

enum class Count : std::uint8_t {
  datagrams_in,
  datagrams_out,
  malformed,   ///< dropped by the decoder, for any reason
  oversized,   ///< malformed, because larger than the network carries (R9)
  unexpected,  ///< well-formed, but not from a client or not now (R6)
  strangers,   ///< messages that need a session and had none (R39)
  unanswered,  ///< answers to strangers that the rate limit kept back (R21)
  connects,
  connects_refused,
  handshakes_given_up,
  clients_lost,
  clients_revived,
  clients_evicted,
  published_up,
  repeats_suppressed,  ///< R75, R76
  unknown_topic_ids,
  topics_refused,       ///< not allowed by the topic policy, or no room
  receipts_refused,     ///< no room upstream: not acknowledged
  unconnected_refused,  ///< QoS -1 that is not allowed (R81)
  delivered_down,
  retransmitted,
  deliveries_given_up,  ///< no acknowledgement after N_retry
  queue_dropped,        ///< a client's queue was full
  too_large_down,       ///< R8
  topics_set_aside,     ///< a client left messages on a topic unanswered, each time
  wills_refused,        ///< not allowed by the topic policy, or invalid
  unvalidated,          ///< not sent, because the address has not shown that it receives
  subscribes_bounded,   ///< SUBSCRIBEs of a client that sends them too fast
  answered_unsaved,     ///< datagrams whose session was not saved in time
  banned,               ///< datagrams from banned addresses
  identity_missing,     ///< datagrams that must come over DTLS (`mqttsn.require_identity`)
  last_ = identity_missing,
};

/// Sends to the configured multicast group.
struct SendMulticast {
  Bytes bytes;
  std::uint32_t interface = 0;  ///< index; 0: on every interface
};

/// An operator's ping has ended. Emitted once for each ping.
struct PingEnded {
  std::uint64_t id = 0;
  OrderAnswer answer;
};

using Action = std::variant<SendDatagram, SendMulticast, PingEnded, MeshEvent>;

class Output {
 public:
  /// `max_clients`: of the ClientTable.
  explicit Output(std::size_t max_clients) : changed_(max_clients), noteworthy_(max_clients) {}

  AddressValidation validation;
  bool is_traced = false;  ///< report every MessageStep; else only repeats

  bool is_validated(const ClientSession& session) const;
  /// Whether a message of `octets` (with the 1-octet Length) may go to this client now.
  bool may_send(const ClientSession& session, std::size_t octets) const;
  /// Sends to the address where the client was last heard. Does nothing when the client has no
  /// address, or when its address is not validated and has no allowance left. A packet on which the
  /// client relies waits until its session is saved.
  void send(const ClientSession& session, Packet packet);
  /// `radius` only matters behind a forwarder (R140). `promised`: the session that must be saved
  /// before the packet leaves.
  void send(const Peer& to, const LocalAddress& from, Packet packet, std::uint8_t radius = 0,
            const ClientSession* promised = nullptr);
  /// Whether the network carries a message of `octets` (with the 1-octet Length) to this client
  /// (R8).
  bool fits(const ClientSession& session, std::size_t octets) const;
  /// Sends on the interface with this index; 0: on every interface.
  void send_multicast(const Packet& packet, std::uint32_t interface = 0);
  void end(PingEnded ping) { actions_.push(std::move(ping)); }
  void emit(MeshEvent event) { actions_.push(std::move(event)); }
  void count(Count what) { ++counts_[static_cast<std::size_t>(what)]; }
  /// Has the session's note told again if it is another one.
  void mark_noteworthy(const ClientSession& session) { noteworthy_.mark(session); }
  /// Call when only what the session's note does not hold has changed.
  void mark_unsaved(const ClientSession& session) { changed_.mark(session); }
  /// Call when something in the session has changed that must survive a restart.
  void mark_changed(const ClientSession& session) {
    changed_.mark(session);
    noteworthy_.mark(session);
  }

  std::optional<Action> next_action() { return actions_.pop(); }
  Counters counters() const;
  bool has_changed() const { return changed_.has_any(); }
  /// Returns and unmarks about `max` changed sessions, by client id; those with waiting answers
  /// come first. Call on_saved() when they are saved.
  std::vector<std::string> take_changed(std::size_t max);

  /// Returns and unmarks at most `max` client ids of sessions whose notes may have changed.
  std::vector<std::string> take_noteworthy(std::size_t max) { return noteworthy_.take(max); }
  bool has_noteworthy() const { return noteworthy_.has_any(); }

  /// Call once when there is a store: answers on which clients rely then wait for it.
  void answer_when_saved() {
    has_store_ = true;
    unsaved_.begin();
  }
  bool has_unsaved_answers() const { return !unsaved_.empty(); }
  /// See SnGateway::on_saved().
  void on_saved(bool is_saved, TimePoint now);
  /// Sends all waiting datagrams; none waits until the next successful save.
  void send_unsaved();

 private:
  static std::size_t overhead(const ClientSession& session, std::size_t octets);

  std::array<std::uint64_t, static_cast<std::size_t>(Count::last_) + 1> counts_{};
  ChangedSessions changed_;
  ChangedSessions noteworthy_;
  UnsavedAnswers unsaved_;
  bool has_store_ = false;
  LogThrottle unsaved_lines_{std::chrono::hours{1}};
  ActionQueue<Action> actions_;
};

}  // namespace slamgw::mqttsn
