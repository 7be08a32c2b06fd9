// SPDX-License-Identifier: Apache-2.0
// Answers to REGISTER, SUBSCRIBE and UNSUBSCRIBE, in the order of their requests (R64): behind a
// SUBACK that waits for the broker, later answers wait too.
#pragma once

#include "adapters/mqttsn_udp/output.hpp"
#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

class Answers {
 public:
  Answers(const Settings& settings, Output& output) : settings_(settings), output_(output) {}

  /// False when too many answers wait: the request should be ignored, its sender repeats it.
  bool has_room(const ClientSession& session) const;
  void answer(ClientSession& session, Packet packet);
  /// The request finds no room: `congestion` says so, unless `when_full` is silent.
  void refuse_for_room(ClientSession& session, Packet congestion);
  /// Keeps a place for the answer to the SUBSCRIBE `msg_id`; a number that names the place.
  std::uint64_t hold(ClientSession& session, std::uint16_t msg_id);
  bool is_held(const ClientSession& session, std::uint16_t msg_id) const;
  /// Nothing happens when the place is gone (the session was cleaned since).
  void release(ClientSession& session, std::uint64_t ticket, Packet packet);

 private:
  const Settings& settings_;
  Output& output_;
  std::uint64_t last_ticket_ = 0;
};

}  // namespace slamgw::mqttsn
