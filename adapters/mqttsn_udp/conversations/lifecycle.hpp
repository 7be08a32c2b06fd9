// SPDX-License-Identifier: Apache-2.0
// The states of a client and what each transition brings with it (MQTT-SN 1.2 section 6.14):
// presence, what is kept and what is forgotten.
#pragma once

#include "adapters/mqttsn_udp/conversations/downlink.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "adapters/mqttsn_udp/conversations/uplink.hpp"
#include "adapters/mqttsn_udp/conversations/wills.hpp"

namespace slamgw::mqttsn {

class Lifecycle : Conversation {
 public:
  Lifecycle(const Conversation& common, Subscriptions& subscriptions, Downlink& downlink,
            Uplink& uplink, Wills& wills)
      : Conversation(common),
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

  Subscriptions& subscriptions_;
  Downlink& downlink_;
  Uplink& uplink_;
  Wills& wills_;
  LogThrottle crowd_lines_;
};

}  // namespace slamgw::mqttsn
