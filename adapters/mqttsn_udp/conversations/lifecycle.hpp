// SPDX-License-Identifier: Apache-2.0
// The states of a client and what each transition brings with it (MQTT-SN 1.2 section 6.14):
// presence, what is kept and what is forgotten.
#pragma once

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/conversations/downlink.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "adapters/mqttsn_udp/conversations/uplink.hpp"
#include "adapters/mqttsn_udp/conversations/wills.hpp"
#include "adapters/mqttsn_udp/output.hpp"
#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

class Lifecycle {
 public:
  Lifecycle(const Settings& settings, ClientTable& clients, Output& output,
            Subscriptions& subscriptions, Downlink& downlink, Uplink& uplink, Wills& wills)
      : settings_(settings),
        clients_(clients),
        output_(output),
        subscriptions_(subscriptions),
        downlink_(downlink),
        uplink_(uplink),
        wills_(wills) {}

  /// Any valid message from the client (R109).
  void on_heard(ClientSession& session, TimePoint now);
  /// A repeated CONNECT, which is no evidence that the robot is here.
  void on_connect_again(ClientSession& session, TimePoint now);
  /// The one writer of the state; presence follows it.
  void enter(ClientSession& session, ClientState state, TimePoint now);
  /// A lost client is heard again (R113). False when it is not lost, or may not come back.
  bool revive(ClientSession& session, TimePoint now);
  /// These two may end the session: it must not be used afterwards.
  void disconnect(ClientSession& session, TimePoint now);
  void lose(ClientSession& session, TimePoint now);
  /// Another client speaks from its address now (R37). May end the session.
  void displace(ClientSession& session, TimePoint now);
  /// Ends the session: commands that wait are refused with `why`.
  void expel(ClientSession& session, const std::string& why, TimePoint now);
  /// As if it had never been connected: subscriptions, will, ids, messages (R42, R43). Its commands
  /// are refused with `why`. The robot's session at the broker stays as it is.
  void clean(ClientSession& session, const std::string& why, TimePoint now);
  /// Another gateway serves the robot: its session ends without a will and without a word. Returns
  /// what was never on the air.
  std::vector<WaitingMessage> give_up(ClientSession& session, TimePoint now);
  /// A place for a new client at `peer`, by forgetting the longest gone, then who has not shown
  /// that it receives (ClientTable::crowd); false when there is none.
  bool make_room(const Peer& peer, TimePoint now);

  void report_presence(ClientSession& session, Presence presence, TimePoint now);

 private:
  void forget(ClientSession& session, const std::string& why, TimePoint now);
  void evict(ClientSession& session, TimePoint now);
  void erase(ClientSession& session);
  void leave(ClientSession& session, ClientState state, TimePoint now);

  const Settings& settings_;
  ClientTable& clients_;
  Output& output_;
  Subscriptions& subscriptions_;
  Downlink& downlink_;
  Uplink& uplink_;
  Wills& wills_;
  LogThrottle crowd_lines_;
};

/// Sleeping clients (MQTT-SN 1.2 section 6.14): a client falls asleep, wakes by its PINGREQ, gets
/// its messages, and sleeps again by PINGRESP.
///
///   active --DISCONNECT(duration)--> asleep --PINGREQ--> awake --nothing left: PINGRESP--> asleep
class Sleep {
 public:
  Sleep(const Settings& settings, ClientTable& clients, Output& output, Downlink& downlink,
        Lifecycle& lifecycle)
      : settings_(settings),
        clients_(clients),
        output_(output),
        downlink_(downlink),
        lifecycle_(lifecycle) {}

  /// DISCONNECT with a duration: nothing is sent from now on, messages wait (R114, R116, R126).
  void fall_asleep(ClientSession& session, std::chrono::seconds duration, TimePoint now);
  /// PINGREQ: what waits is sent, and some of what comes meanwhile (R118, R122). A repeated PINGREQ
  /// changes nothing (R123).
  void wake(ClientSession& session, TimePoint now);
  static bool is_asleep(const ClientSession& session) {
    return presence_of(session.state()) == Presence::asleep;
  }
  /// Its PINGREQ came from this address, perhaps a new one (R118).
  void follow(ClientSession& session, const Peer& peer, const LocalAddress& local, TimePoint now);
  /// After each step of the delivery: with nothing left to send or to await, PINGRESP lets the
  /// client sleep again for the same duration (R119, R120).
  void settle(ClientSession& session, TimePoint now);
  /// The awake client has left something unanswered; messages wait for its next PINGREQ (R124).
  void on_unanswered(ClientSession& session, TimePoint now);

 private:
  void sleep_again(ClientSession& session, TimePoint now);

  const Settings& settings_;
  ClientTable& clients_;
  Output& output_;
  Downlink& downlink_;
  Lifecycle& lifecycle_;
};

/// Handles the timers of clients: keep-alive and sleep run out (MQTT-SN 1.2 sections 6.11, 6.14),
/// requests are repeated, commands expire. Also the step that follows each event of a client:
/// it is sent what may be sent.
class Supervision {
 public:
  Supervision(const Settings& settings, ClientTable& clients, CommandWatch& commands,
              Downlink& downlink, Lifecycle& lifecycle, Sleep& sleep)
      : settings_(settings),
        clients_(clients),
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

  const Settings& settings_;
  ClientTable& clients_;
  CommandWatch& commands_;
  Downlink& downlink_;
  Lifecycle& lifecycle_;
  Sleep& sleep_;
};

}  // namespace slamgw::mqttsn
