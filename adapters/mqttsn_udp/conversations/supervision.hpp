// SPDX-License-Identifier: Apache-2.0
// What time brings to clients: keep-alive and sleep run out (MQTT-SN 1.2 sections 6.11, 6.14),
// requests are repeated, commands are too late. Also the step that follows each event of a client:
// it is sent what may be sent.
#pragma once

#include "adapters/mqttsn_udp/conversations/sleep.hpp"

namespace slamgw::mqttsn {

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
