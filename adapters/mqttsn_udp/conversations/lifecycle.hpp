// SPDX-License-Identifier: Apache-2.0
// The states of a client and the effects of each transition (MQTT-SN 1.2 section 6.14): presence,
// and what is kept and forgotten.
#pragma once

#include "adapters/mqttsn_udp/conversations/downlink.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "adapters/mqttsn_udp/conversations/wills.hpp"

namespace slamgw::mqttsn {

class Lifecycle : Conversation {
 public:
  Lifecycle(const Conversation& common, Subscriptions& subscriptions, Downlink& downlink,
            Wills& wills)
      : Conversation(common), subscriptions_(subscriptions), downlink_(downlink), wills_(wills) {}

  /// Call for any valid message from the client (R109).
  void on_heard(ClientSession& session, TimePoint now);
  /// Call for a repeated CONNECT, which does not prove that the robot is here.
  void note_heard(ClientSession& session, TimePoint now);
  /// Sets the state, which nothing else does, and reports the presence that follows from it.
  void enter(ClientSession& session, ClientState state, TimePoint now);
  /// Brings back a lost client that is heard again (R113). It is asleep again if it was when it was
  /// lost. Returns false if it is not lost, or may not come back.
  bool revive(ClientSession& session, TimePoint now);
  /// These two may end the session: it must not be used afterwards.
  void disconnect(ClientSession& session, TimePoint now);
  void lose(ClientSession& session, TimePoint now);
  /// Takes the address of a client away, as when another client sends from it (R37). A client that
  /// was active is lost. May end the session.
  void displace(ClientSession& session, TimePoint now);
  /// Ends the session: commands that wait are refused with `why`.
  void expel(ClientSession& session, const std::string& why, TimePoint now);
  /// Forgets subscriptions, will, ids and messages, as if the client had never connected (R42,
  /// R43). Its commands are refused with `why`. The robot's session at the broker stays as it is.
  void clean(ClientSession& session, const std::string& why, TimePoint now);
  /// Call when another gateway serves the robot. Ends its session here without a will or a packet.
  /// Returns the messages that were never on the air.
  std::vector<WaitingMessage> give_up(ClientSession& session, TimePoint now);
  /// Makes a place for a new client at `peer`: forgets evictable clients, then others that have not
  /// shown that they receive (ClientTable::crowd). Returns false if that is impossible.
  bool make_room(const Peer& peer, TimePoint now);

  void report_presence(ClientSession& session, Presence presence, TimePoint now);

 private:
  void forget(ClientSession& session, const std::string& why, TimePoint now);
  void evict(ClientSession& session, TimePoint now);
  void erase(ClientSession& session);
  void leave(ClientSession& session, ClientState state, TimePoint now);

  Subscriptions& subscriptions_;
  Downlink& downlink_;
  Wills& wills_;
  LogThrottle crowd_lines_;
};

}  // namespace slamgw::mqttsn
