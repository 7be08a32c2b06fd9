// SPDX-License-Identifier: Apache-2.0
// D-Bus between the radio and bluetooth-meshd: makes the radio's calls, and offers the objects that
// meshd calls. A bus or a meshd that is not there is a state, not a failure. Nothing waits: sd-bus
// gets its turns from the loop. Loop's thread only.
#pragma once

#include <systemd/sd-bus.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "adapters/ble_mesh_bluez/meshd_call.hpp"

namespace slamgw::ble {

template <auto unref>
struct SdBusUnref {
  void operator()(auto* object) const { unref(object); }
};
using SdBus = std::unique_ptr<sd_bus, SdBusUnref<sd_bus_close_unref>>;
using SdBusSlot = std::unique_ptr<sd_bus_slot, SdBusUnref<sd_bus_slot_unref>>;
using SdBusMessage = std::unique_ptr<sd_bus_message, SdBusUnref<sd_bus_message_unref>>;

class MeshdBus {
 public:
  static constexpr std::chrono::seconds reopen_after{2};
  /// Messages in one turn of the loop.
  static constexpr int max_at_once = 64;

  /// `address` of the bus; empty: the system bus. `static_oob` of robots that join, if they have
  /// one.
  MeshdBus(boost::asio::io_context& io, std::string address, std::optional<Key> static_oob,
           std::function<void(MeshdEvent)> on_event);

  void open();
  void close();
  void perform(const MeshdRequest& request);

 private:
  struct Pending {
    MeshdBus& bus;
    std::uint64_t number = 0;
    MeshdCall call;
    SdBusSlot slot = {};
  };

  int connect();
  int offer_objects();
  void fail(int error);
  void open_later();
  void watch();
  void on_ready();
  void set_owner(std::string owner);

  SdBusMessage to(const char* path, const char* interface, const char* member) const;
  SdBusMessage to_node(const char* interface, const char* member) const {
    return to(node_path_.c_str(), interface, member);
  }
  SdBusMessage compose(const Attach& call) const;
  SdBusMessage compose(const Import& call) const;
  SdBusMessage compose(const Leave& call) const;
  SdBusMessage compose(const ImportSubnet& call) const;
  SdBusMessage compose(const ImportAppKey& call) const;
  SdBusMessage compose(const ImportRemoteNode& call) const;
  SdBusMessage compose(const DeleteRemoteNode& call) const;
  SdBusMessage compose(const ExportKeys& call) const;
  SdBusMessage compose(const UnprovisionedScan& call) const;
  SdBusMessage compose(const UnprovisionedScanCancel& call) const;
  SdBusMessage compose(const AddNode& call) const;
  SdBusMessage compose(const Send& call) const;
  SdBusMessage compose(const DevKeySend& call) const;
  SdBusMessage compose(const GetAddresses& call) const;
  SdBusMessage compose(const GetIvIndex& call) const;
  SdBusMessage get_property(const char* name) const;

  void make_call(const CallMeshd& wanted);
  void answer(SdBusMessage& waiting, const GiveAddress& given);
  void read_answer(sd_bus_message* reply, const MeshdCall& call, MeshdAnswer& answer);

  // Called by sd-bus.
  static int on_filter(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_owner_changed(sd_bus_message* message, void* bus, sd_bus_error* error);
  static int on_owner(sd_bus_message* message, void* bus, sd_bus_error* error);
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
  struct Objects;  ///< their vtables

  boost::asio::io_context& io_;
  std::string address_;
  std::optional<Key> static_oob_;
  std::function<void(MeshdEvent)> on_event_;
  SdBus bus_;
  std::optional<boost::asio::posix::stream_descriptor> socket_;  ///< to wait at
  boost::asio::steady_timer timer_;  ///< sd-bus's own deadline, or the next attempt to open
  bool is_reading_ = false;
  bool is_writing_ = false;
  std::string owner_;  ///< of org.bluez.mesh; empty: it is not there
  std::string node_path_;
  std::map<std::uint64_t, Pending> pending_;
  SdBusMessage join_complete_;      ///< waits for its answer
  SdBusMessage prov_data_request_;  ///< waits for its answer
  /// Each connection has one. A handler that is still queued when the connection closes sees by it
  /// that it must do nothing.
  std::shared_ptr<void> life_;
};

}  // namespace slamgw::ble
