// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/tally.hpp"

namespace slamgw::mqttsn {

Counters Tally::counters() const {
  constexpr std::array<std::string_view, size> names = {
      "datagrams_in",     "datagrams_out",       "malformed",           "oversized",
      "unexpected",       "strangers",           "unanswered",          "connects",
      "connects_refused", "handshakes_given_up", "clients_lost",        "clients_revived",
      "clients_evicted",  "published_up",        "repeats_suppressed",  "unknown_topic_ids",
      "topics_refused",   "receipts_refused",    "unconnected_refused", "delivered_down",
      "retransmitted",    "deliveries_given_up", "queue_dropped",       "too_large_down",
      "topics_set_aside", "wills_refused",       "unvalidated",         "subscribes_bounded",
      "answered_unsaved"};
  static_assert(!names.back().empty(), "a name for each counter");
  Counters counters;
  for (std::size_t i = 0; i < size; ++i) counters.push_back({names[i], values_[i]});
  return counters;
}

}  // namespace slamgw::mqttsn
