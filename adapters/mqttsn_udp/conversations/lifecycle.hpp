// SPDX-License-Identifier: Apache-2.0
// The states of a client and what each transition brings with it (MQTT-SN 1.2 section 6.14):
// supervision, presence, what is kept and what is forgotten.
#pragma once

#include "adapters/mqttsn_udp/context.hpp"
#include "adapters/mqttsn_udp/conversations/downlink.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "adapters/mqttsn_udp/conversations/uplink.hpp"
#include "adapters/mqttsn_udp/conversations/wills.hpp"

namespace slamgw::mqttsn {

class Lifecycle {
 public:
  Lifecycle(Context& context, Subscriptions& subscriptions, Downlink& downlink, Uplink& uplink,
            Wills& wills)
      : context_(context),
        subscriptions_(subscriptions),
        downlink_(downlink),
        uplink_(uplink),
        wills_(wills) {}

  /// Any valid message from the client (R109).
  void on_heard(ClientSession& session, TimePoint now);
  void activate(ClientSession& session, TimePoint now);
  void sleep(ClientSession& session, std::chrono::seconds duration, TimePoint now);
  /// These two may end the session: it must not be used afterwards.
  void disconnect(ClientSession& session, TimePoint now);
  void lose(ClientSession& session, TimePoint now);
  /// Another client speaks from its address now (R37). May end the session.
  void displace(ClientSession& session, TimePoint now);
  /// Ends the session of a client that may not have it any more.
  void expel(ClientSession& session, TimePoint now);
  /// As if it had never been connected: subscriptions, will, ids, messages (R42, R43).
  void clean(ClientSession& session, TimePoint now);
  /// A place for a new client, by forgetting the longest gone; false when there is none.
  bool make_room(TimePoint now);

  /// Its time has come: lost, or something to repeat. May end the session.
  void on_time(ClientSession& session, TimePoint now);
  void schedule(ClientSession& session);
  void tell_presence(ClientSession& session, Presence presence);

 private:
  std::optional<TimePoint> lost_at(const ClientSession& session) const;
  void forget(ClientSession& session, TimePoint now);
  void leave(ClientSession& session, ClientState state, TimePoint now);

  Context& context_;
  Subscriptions& subscriptions_;
  Downlink& downlink_;
  Uplink& uplink_;
  Wills& wills_;
};

}  // namespace slamgw::mqttsn
