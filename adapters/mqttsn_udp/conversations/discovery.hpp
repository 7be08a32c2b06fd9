// SPDX-License-Identifier: Apache-2.0
// ADVERTISE and the answer to SEARCHGW (MQTT-SN 1.2 section 6.1), both only while a client could be
// served.
#pragma once

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/conversations/flood_guard.hpp"
#include "adapters/mqttsn_udp/output.hpp"
#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

class Discovery {
 public:
  Discovery(const Settings& settings, ClientTable& clients, Output& output, FloodGuard& guard)
      : settings_(settings), clients_(clients), output_(output), guard_(guard) {}

  void on_searchgw(const Peer& peer, const LocalAddress& local, const SearchGw& search,
                   TimePoint now);
  /// The broker is back: an ADVERTISE at once (R11, R12).
  void on_broker_link(bool is_up, TimePoint now);
  /// A network interface, or its lasting address, has appeared: an ADVERTISE there, if clients
  /// could be served (R11).
  void on_interface(std::uint32_t index);
  std::optional<TimePoint> deadline() const { return next_advertise_; }
  void on_deadline(TimePoint now);

 private:
  void advertise(TimePoint now);
  Advertise advertisement() const;

  const Settings& settings_;
  ClientTable& clients_;
  Output& output_;
  FloodGuard& guard_;
  bool is_broker_up_ = false;
  std::optional<TimePoint> next_advertise_;
};

}  // namespace slamgw::mqttsn
