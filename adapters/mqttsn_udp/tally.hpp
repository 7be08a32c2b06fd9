// SPDX-License-Identifier: Apache-2.0
// The machine's counters: one enumerator and one stable name each.
#pragma once

#include <array>
#include <cstdint>

#include "daemon/core/messages.hpp"

namespace slamgw::mqttsn {

enum class Count : std::uint8_t {
  datagrams_in,
  datagrams_out,
  malformed,   ///< dropped by the decoder, of whatever kind
  oversized,   ///< of these: larger than the network carries (R9)
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
  topics_refused,       ///< not allowed by the topic policy
  receipts_refused,     ///< no room upstream: not acknowledged
  unconnected_refused,  ///< QoS -1 that is not allowed (R81)
  delivered_down,
  retransmitted,
  deliveries_given_up,  ///< no acknowledgement after N_retry
  queue_dropped,        ///< a client's queue was full
  too_large_down,       ///< R8
  topics_set_aside,     ///< of one client, each time that it leaves messages on it unanswered
  wills_refused,        ///< not allowed by the topic policy, or no topic
  unvalidated,          ///< not sent, because the address has not shown that it receives
  subscribes_bounded,   ///< SUBSCRIBEs of a client that sends them too fast
  answered_unsaved,     ///< datagrams whose session was not saved in time
  last_ = answered_unsaved,
};

class Tally {
 public:
  void count(Count what) { ++values_[static_cast<std::size_t>(what)]; }
  Counters counters() const;

 private:
  static constexpr std::size_t size = static_cast<std::size_t>(Count::last_) + 1;
  std::array<std::uint64_t, size> values_{};
};

}  // namespace slamgw::mqttsn
