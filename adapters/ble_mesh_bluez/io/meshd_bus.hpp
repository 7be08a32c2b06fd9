// SPDX-License-Identifier: Apache-2.0
// D-Bus between the radio and bluetooth-meshd: makes the radio's calls, and offers the objects that
// meshd calls. Loop's thread only.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>

#include "adapters/ble_mesh_bluez/meshd_call.hpp"
#include "daemon/runtime/bus_connection.hpp"

namespace slamgw::ble {

class MeshdBus {
 public:
  /// `address` as for BusConnection. `static_oob`: the value of joining robots, if they have one.
  MeshdBus(boost::asio::io_context& io, std::string address, std::optional<Key> static_oob,
           std::function<void(MeshdEvent)> on_event);

  void open() { connection_.open(); }
  void close();
  void perform(const MeshdRequest& request);

 private:
  struct Pending {
    MeshdBus& bus;
    std::uint64_t number = 0;
    MeshdCall call;
    SdBusSlot slot = {};
  };

  int offer_objects(sd_bus* bus);
  void on_meshd(const std::string& fault);
  void forget_calls();

  void make_call(const CallMeshd& wanted);
  void answer(SdBusMessage& waiting, const GiveAddress& given);
  void read_answer(sd_bus_message* reply, const MeshdCall& call, MeshdAnswer& answer);

  // Called by sd-bus.
  static int on_filter(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_reply(sd_bus_message* message, void* pending, sd_bus_error* error);
  static int on_join_complete(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_scan_result(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_prov_data_wanted(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_node_added(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_node_failed(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_message(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_device_key_message(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_prompt_static(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int get_capabilities(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply,
                              void* bus, sd_bus_error*);
  struct Objects;  ///< the vtables of the offered objects

  std::optional<Key> static_oob_;
  std::function<void(MeshdEvent)> on_event_;
  BusConnection connection_;
  std::string node_path_;
  std::map<std::uint64_t, Pending> pending_;
  SdBusMessage join_complete_;      ///< waits for its answer
  SdBusMessage prov_data_request_;  ///< waits for its answer
};

}  // namespace slamgw::ble
