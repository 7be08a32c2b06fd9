// SPDX-License-Identifier: Apache-2.0
// How a client falls asleep, wakes, and gets what has waited for it; and the timers of all clients,
// with the step that follows each event of one. Called by SnGateway. Pure.
#pragma once

#include <chrono>
#include <optional>

#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"

namespace slamgw::mqttsn {

/// Sleeping clients (MQTT-SN 1.2 section 6.14): a client falls asleep, wakes by its PINGREQ, gets
/// its messages, and sleeps again by PINGRESP.
///
///   active --DISCONNECT(duration)--> asleep --PINGREQ--> awake --nothing left: PINGRESP--> asleep
class Sleep : Conversation {
 public:
  Sleep(const Conversation& common, Downlink& downlink, Lifecycle& lifecycle)
      : Conversation(common), downlink_(downlink), lifecycle_(lifecycle) {}

  /// DISCONNECT with a duration: nothing is sent from now on, messages wait (R114, R116, R126).
  void fall_asleep(ClientSession& session, std::chrono::seconds duration, TimePoint now);
  /// PINGREQ: what waits is sent, and some of what comes meanwhile (R118, R122). A repeated PINGREQ
  /// changes nothing (R123).
  void wake(ClientSession& session, TimePoint now);
  static bool is_asleep(const ClientSession& session) {
    return presence_of(session.state()) == Presence::asleep;
  }
  /// Its PINGREQ came from this address, perhaps a new one (R118).
  void follow(ClientSession& session, const Arrival& arrival);
  /// After each step of the delivery: with nothing left to send or to await, PINGRESP lets the
  /// client sleep again for the same duration (R119, R120).
  void settle(ClientSession& session, TimePoint now);
  /// The awake client has left something unanswered; messages wait for its next PINGREQ (R124).
  void on_unanswered(ClientSession& session, TimePoint now);

 private:
  void sleep_again(ClientSession& session, TimePoint now);

  Downlink& downlink_;
  Lifecycle& lifecycle_;
};

/// Handles the timers of clients: keep-alive and sleep run out (MQTT-SN 1.2 sections 6.11, 6.14),
/// requests are repeated, commands expire. Also the step that follows each event of a client:
/// it is sent what may be sent.
class Supervision : Conversation {
 public:
  Supervision(const Conversation& common, CommandWatch& commands, Downlink& downlink,
              Lifecycle& lifecycle, Sleep& sleep)
      : Conversation(common),
        commands_(commands),
        downlink_(downlink),
        lifecycle_(lifecycle),
        sleep_(sleep) {}

  /// Sends what may be sent, ends a wake-up that has nothing left, and sets the session's timer.
  void advance(ClientSession& session, TimePoint now);
  /// Withdraws and reports commands whose time is over.
  void expire_commands(TimePoint now);

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  void on_time(ClientSession& session, TimePoint now);
  std::optional<TimePoint> lost_at(const ClientSession& session) const;

  CommandWatch& commands_;
  Downlink& downlink_;
  Lifecycle& lifecycle_;
  Sleep& sleep_;
};

}  // namespace slamgw::mqttsn
