// SPDX-License-Identifier: Apache-2.0
// ADVERTISE and the answer to SEARCHGW (MQTT-SN 1.2 section 6.1), both only while a client could be
// served.
#pragma once

#include <array>
#include <cstddef>

#include "adapters/mqttsn_udp/conversations/conversation.hpp"
#include "daemon/core/time.hpp"
#include "daemon/core/token_bucket.hpp"

namespace slamgw::mqttsn {

/// Limits the answers to strangers: a small burst each, then a few a second, and a bound on all of
/// them together (R21, R39). Sources share a fixed number of places by hash, so a flood of
/// addresses costs no memory.
class FloodGuard {
 public:
  bool may_answer(const Peer& peer, TimePoint now);

 private:
  static constexpr std::size_t places = 1024;
  std::array<TokenBucket, places> sources_;
  TokenBucket all_;
};

class Discovery : Conversation {
 public:
  Discovery(const Conversation& common, FloodGuard& guard) : Conversation(common), guard_(guard) {}

  void on_searchgw(const Arrival& arrival, std::uint8_t radius);
  /// Sends an ADVERTISE at once when the broker is back (R11, R12).
  void on_broker_link(bool is_up, TimePoint now);
  /// Call when a network interface, or its lasting address, has appeared. Sends an ADVERTISE there
  /// if clients could be served (R11).
  void on_interface(std::uint32_t index);
  std::optional<TimePoint> deadline() const { return next_advertise_; }
  void on_deadline(TimePoint now);

 private:
  bool is_advertised() const;
  void advertise(TimePoint now);
  Advertise advertisement() const;

  FloodGuard& guard_;
  bool is_broker_up_ = false;
  std::optional<TimePoint> next_advertise_;
};

}  // namespace slamgw::mqttsn
