// SPDX-License-Identifier: Apache-2.0
// The timers of clients, and the step that follows each event of one. Called by SnGateway. Pure.
#pragma once

#include <optional>

#include "adapters/mqttsn_udp/conversations/command_watch.hpp"
#include "adapters/mqttsn_udp/conversations/sleep.hpp"

namespace slamgw::mqttsn {

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
