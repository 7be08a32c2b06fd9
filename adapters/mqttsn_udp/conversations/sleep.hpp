// SPDX-License-Identifier: Apache-2.0
// Sleeping clients: how a client falls asleep, wakes, and gets the messages that waited for it.
// Also the timers of all clients, and the step that follows each event of a client. Called by
// SnGateway. Pure.
#pragma once

#include <chrono>
#include <optional>

#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"

namespace slamgw::mqttsn {

/// Sleeping clients (MQTT-SN 1.2 section 6.14): a client falls asleep, wakes by its PINGREQ, gets
/// its messages, and sleeps again by PINGRESP.
///
///   active --DISCONNECT(duration)--> asleep --PINGREQ--> awake --nothing left: PINGRESP--> asleep
///
/// Handles the timers of all clients, too: keep-alive and sleep run out (sections 6.11, 6.14),
/// requests are repeated, commands expire.
class Supervision : Conversation {
 public:
  Supervision(const Conversation& common, Downlink& downlink, Lifecycle& lifecycle)
      : Conversation(common), downlink_(downlink), lifecycle_(lifecycle) {}

  /// Handles DISCONNECT with a duration: sends nothing more, and messages wait (R114, R116, R126).
  void fall_asleep(ClientSession& session, std::chrono::seconds duration, TimePoint now);
  /// Handles PINGREQ: sends the messages that wait, and some that come while the client is awake
  /// (R118, R122). A repeated PINGREQ changes nothing (R123).
  void wake(ClientSession& session, TimePoint now);
  static bool is_asleep(const ClientSession& session) {
    return presence_of(session.state()) == Presence::asleep;
  }
  /// Binds the session to the address from which its client sends now, perhaps a new one (R118).
  void follow(ClientSession& session, const Arrival& arrival);

  /// Call after each event of a client. Sends what may be sent, ends a wake-up that has nothing
  /// left, and sets the session's timer.
  void advance(ClientSession& session, TimePoint now);
  std::optional<TimePoint> deadline() const { return clients_.earliest(); }
  void on_deadline(TimePoint now);

 private:
  void settle(ClientSession& session, TimePoint now);
  void sleep_again(ClientSession& session, TimePoint now);
  void on_time(ClientSession& session, TimePoint now);
  std::optional<TimePoint> lost_at(const ClientSession& session) const;

  Downlink& downlink_;
  Lifecycle& lifecycle_;
};

}  // namespace slamgw::mqttsn
