// SPDX-License-Identifier: Apache-2.0
// Announces the MQTT-SN port on the LAN by DNS-SD (`_mqttsn._udp`), through avahi-daemon over
// D-Bus. The announcement ends with the process. Called by MqttsnAdapter; loop's thread only.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/runtime/bus_connection.hpp"

namespace slamgw::mqttsn {

class LanAnnouncement {
 public:
  /// Most names that are tried when others have the service's name. After them, Avahi's next start
  /// or a change of the host's name begins again.
  static constexpr int max_names = 20;

  struct Service {
    std::string name;  ///< at most 50 octets; " #2" and so on follows when another has it
    std::uint16_t port = 0;
    int interface = 0;  ///< index; 0: every interface
    bool is_ipv4_only = false;
  };

  /// `bus_address` as for BusConnection. `report` gets lines for the log.
  LanAnnouncement(boost::asio::io_context& io, std::string bus_address,
                  std::function<void(Notice)> report);

  /// Announces the service now, and again whenever Avahi comes back.
  void announce(Service service);
  void withdraw();

 private:
  void on_avahi(const std::string& fault);
  void forget_group();
  void add();
  void rename();
  void report(Severity severity, std::string text);
  static int on_host_name(sd_bus_message* message, void* self, sd_bus_error* error);
  static int on_group(sd_bus_message* reply, void* self, sd_bus_error* error);
  static int on_added(sd_bus_message* reply, void* self, sd_bus_error* error);
  static int on_state(sd_bus_message* message, void* self, sd_bus_error* error);

  std::function<void(Notice)> report_;
  BusConnection connection_;
  Service service_;
  std::string group_;     ///< path of the entry group; empty: there is none
  int name_number_ = 1;   ///< of the name that is being tried
  std::string reported_;  ///< the last line, which is not repeated
  // Reset when Avahi is gone, so that its answers do not count.
  SdBusSlot host_names_;
  SdBusSlot states_;
  SdBusSlot call_;
};

}  // namespace slamgw::mqttsn
