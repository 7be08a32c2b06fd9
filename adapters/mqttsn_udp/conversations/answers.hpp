// SPDX-License-Identifier: Apache-2.0
// Answers to REGISTER, SUBSCRIBE and UNSUBSCRIBE, in the order of their requests (R64): behind a
// SUBACK that waits for the broker, later answers wait too.
#pragma once

#include <string>

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
  /// `suback` waits for the broker's answer about `filter`.
  void hold(ClientSession& session, const std::string& filter, const Suback& suback);
  bool is_held(const ClientSession& session, std::uint16_t msg_id) const;
  /// The broker's answer: for all that wait for it.
  void release(ClientSession& session, const std::string& filter, bool granted);

 private:
  const Settings& settings_;
  Output& output_;
};

}  // namespace slamgw::mqttsn
