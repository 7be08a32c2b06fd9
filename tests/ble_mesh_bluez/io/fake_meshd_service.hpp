// SPDX-License-Identifier: Apache-2.0
// A FakeMeshd on a bus, as org.bluez.mesh. Reads the application's objects at Import and Attach, as
// the real one does, and checks their types.
#pragma once

#include <systemd/sd-bus.h>

#include <functional>
#include <map>
#include <set>
#include <string>

#include "adapters/ble_mesh_bluez/io/meshd_bus.hpp"
#include "tests/ble_mesh_bluez/fake_meshd.hpp"

namespace slamgw::ble {

class FakeMeshdService {
 public:
  explicit FakeMeshdService(std::string address) : address_(std::move(address)) {}

  /// Joins the bus. leave() leaves it; the state on disk stays.
  void come();
  void leave();
  /// Processes messages from the bus, and sends those of the fake.
  void process();
  /// Sends a robot's message to the application as another program; returns the error's name.
  std::string try_to_speak(const std::string& application, const std::string& element,
                           const std::function<void()>& run);
  const std::string& name_of_application() const { return owner_; }

  FakeMeshd meshd;
  std::string application;  ///< its object's path, once its interfaces are checked
  std::string agent;
  std::string element;
  std::set<std::string> capabilities;  ///< of the agent
  Bytes prompted;                      ///< the static OOB that the agent gave
  /// All calls of both sides: "gateway org.bluez.mesh.Node1.Send oqqa{sv}ay".
  std::set<std::string> calls;

 private:
  void connect();
  struct Waiting {
    SdBusMessage message;
    MeshdCall call;
  };
  struct Objects;

  static int on_attach(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_import(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_leave(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_import_subnet(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_import_app_key(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_import_remote_node(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_export_keys(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_scan(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_scan_cancel(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_add_node(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_send(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_dev_key_send(sd_bus_message* message, void* self, sd_bus_error*);
  static int get_addresses(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply,
                           void* self, sd_bus_error*);
  static int get_iv_index(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply,
                          void* self, sd_bus_error*);
  static int on_objects(sd_bus_message* reply, void* self, sd_bus_error*);
  static int on_agent_properties(sd_bus_message* reply, void* self, sd_bus_error*);
  static int on_static_oob(sd_bus_message* reply, void* self, sd_bus_error*);
  static int on_token_taken(sd_bus_message* reply, void* self, sd_bus_error*);
  static int on_prov_data(sd_bus_message* reply, void* self, sd_bus_error*);

  int take(sd_bus_message* message, MeshdCall call);
  int look_at_application(sd_bus_message* message, MeshdCall call);
  void read_object(sd_bus_message* reply);
  void read_interface(sd_bus_message* reply, const std::string& path);
  void say(MeshdEvent& event);
  void answer(const MeshdAnswer& what);
  SdBusMessage call_to(const std::string& path, const char* interface, const char* member);
  /// Sends without expecting an answer if `done` is null.
  void send(SdBusMessage message, sd_bus_message_handler_t done);
  void note(const char* who, sd_bus_message* call);
  static int on_owner_changed(sd_bus_message* message, void* self, sd_bus_error*);
  static int on_filter(sd_bus_message* message, void* self, sd_bus_error*);

  std::string address_;
  SdBus bus_;
  std::string owner_;  ///< the application's connection
  std::map<std::uint64_t, Waiting> waiting_;
  std::uint64_t last_number_ = 0;
  std::uint64_t looking_ = 0;  ///< the call for which the objects are read
  std::string app_root_;
};

}  // namespace slamgw::ble
