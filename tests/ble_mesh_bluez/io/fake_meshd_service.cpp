// SPDX-License-Identifier: Apache-2.0
#include "tests/ble_mesh_bluez/io/fake_meshd_service.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "daemon/core/result.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/private_bus.hpp"

namespace slamgw::ble {
namespace {

constexpr const char* node_prefix = "/org/bluez/mesh/node";

Bytes read_octets(sd_bus_message* message) {
  const void* data = nullptr;
  std::size_t size = 0;
  EXPECT_GE(sd_bus_message_read_array(message, 'y', &data, &size), 0);
  const auto* const first = static_cast<const std::uint8_t*>(data);
  return {first, first + size};
}

Key read_key(sd_bus_message* message) {
  const Bytes octets = read_octets(message);
  Key key{};
  EXPECT_EQ(octets.size(), key.size());
  if (octets.size() == key.size()) std::ranges::copy(octets, key.begin());
  return key;
}

void append_octets(sd_bus_message* message, const Bytes& octets) {
  sd_bus_message_append_array(message, 'y', octets.data(), octets.size());
}

void demand_no_options(sd_bus_message* message) {
  EXPECT_GT(sd_bus_message_enter_container(message, 'a', "{sv}"), 0);
  EXPECT_EQ(sd_bus_message_at_end(message, 0), 1) << "meshd refuses unknown options";
  sd_bus_message_exit_container(message);
}

FakeMeshdService& service(void* self) { return *static_cast<FakeMeshdService*>(self); }

}  // namespace

struct FakeMeshdService::Objects {
  static constexpr std::uint64_t open = SD_BUS_VTABLE_UNPRIVILEGED;
  static constexpr sd_bus_vtable network[] = {
      SD_BUS_VTABLE_START(0), SD_BUS_METHOD("Attach", "ot", "oa(ya(qa{sv}))", on_attach, open),
      SD_BUS_METHOD("Import", "oayayayqa{sv}uq", "", on_import, open),
      SD_BUS_METHOD("Leave", "t", "", on_leave, open), SD_BUS_VTABLE_END};
  static constexpr sd_bus_vtable management[] = {
      SD_BUS_VTABLE_START(0),
      SD_BUS_METHOD("ImportSubnet", "qay", "", on_import_subnet, open),
      SD_BUS_METHOD("ImportAppKey", "qqay", "", on_import_app_key, open),
      SD_BUS_METHOD("ImportRemoteNode", "qyay", "", on_import_remote_node, open),
      SD_BUS_METHOD("ExportKeys", "", "a{sv}", on_export_keys, open),
      SD_BUS_METHOD("UnprovisionedScan", "a{sv}", "", on_scan, open),
      SD_BUS_METHOD("UnprovisionedScanCancel", "", "", on_scan_cancel, open),
      SD_BUS_METHOD("AddNode", "aya{sv}", "", on_add_node, open),
      SD_BUS_VTABLE_END};
  static constexpr sd_bus_vtable node[] = {
      SD_BUS_VTABLE_START(0),
      SD_BUS_METHOD("Send", "oqqa{sv}ay", "", on_send, open),
      SD_BUS_METHOD("DevKeySend", "oqbqa{sv}ay", "", on_dev_key_send, open),
      SD_BUS_PROPERTY("Addresses", "aq", get_addresses, 0, 0),
      SD_BUS_PROPERTY("IvIndex", "u", get_iv_index, 0, 0),
      SD_BUS_VTABLE_END};
};

// --- The bus -------------------------------------------------------------------------------------

void FakeMeshdService::connect() {
  bus_ = test::connect_to_bus(address_);
  ASSERT_TRUE(bus_);
}

void FakeMeshdService::come() {
  connect();
  sd_bus_add_object_vtable(bus_.get(), nullptr, "/org/bluez/mesh", "org.bluez.mesh.Network1",
                           Objects::network, this);
  ASSERT_GE(sd_bus_add_filter(bus_.get(), nullptr, on_filter, this), 0);
  ASSERT_GE(
      sd_bus_match_signal(bus_.get(), nullptr, "org.freedesktop.DBus", "/org/freedesktop/DBus",
                          "org.freedesktop.DBus", "NameOwnerChanged", on_owner_changed, this),
      0);
  ASSERT_GE(sd_bus_request_name(bus_.get(), "org.bluez.mesh", 0), 0);
}

int FakeMeshdService::on_owner_changed(sd_bus_message* message, void* self, sd_bus_error*) {
  const char *name = nullptr, *before = nullptr, *after = nullptr;
  sd_bus_message_read(message, "sss", &name, &before, &after);
  if (service(self).owner_ == name && *after == '\0') service(self).meshd.detach();
  return 0;
}

std::string FakeMeshdService::try_to_speak(const std::string& other, const std::string& path,
                                           const std::function<void()>& run) {
  connect();
  owner_ = other;
  SdBusMessage call = call_to(path, "org.bluez.mesh.Element1", "MessageReceived");
  sd_bus_message_append(call.get(), "qqv", 0x0100, 0, "q", 1);
  append_octets(call.get(), hex("c9 59 00 0a 00 ec ff"));
  std::string error;
  const auto keep = [](sd_bus_message* reply, void* where, sd_bus_error*) {
    const sd_bus_error* const failure = sd_bus_message_get_error(reply);
    *static_cast<std::string*>(where) = failure != nullptr ? failure->name : "none";
    return 0;
  };
  EXPECT_GE(sd_bus_call_async(bus_.get(), nullptr, call.get(), keep, &error, 0), 0);
  EXPECT_TRUE(test::eventually([&] {
    run();
    while (sd_bus_process(bus_.get(), nullptr) > 0) {
    }
    return !error.empty();
  }));
  return error;
}

void FakeMeshdService::leave() {
  waiting_.clear();
  bus_.reset();
  meshd.restart();
}

void FakeMeshdService::process() {
  while (bus_ && sd_bus_process(bus_.get(), nullptr) > 0) {
  }
  while (bus_ && !meshd.events.empty()) {
    MeshdEvent event = std::move(meshd.events.front());
    meshd.events.pop_front();
    say(event);
  }
}

int FakeMeshdService::take(sd_bus_message* message, MeshdCall call) {
  waiting_[++last_number_] = {SdBusMessage(sd_bus_message_ref(message)), call};
  meshd.call({last_number_, std::move(call)});
  return 1;
}

// --- Calls of the application --------------------------------------------------------------------

int FakeMeshdService::look_at_application(sd_bus_message* message, MeshdCall call) {
  owner_ = sd_bus_message_get_sender(message);
  looking_ = ++last_number_;
  waiting_[looking_] = {SdBusMessage(sd_bus_message_ref(message)), std::move(call)};
  application.clear();
  agent.clear();
  element.clear();
  send(call_to(app_root_, "org.freedesktop.DBus.ObjectManager", "GetManagedObjects"), on_objects);
  return 1;
}

int FakeMeshdService::on_attach(sd_bus_message* message, void* self, sd_bus_error*) {
  const char* root = nullptr;
  Attach call;
  sd_bus_message_read(message, "ot", &root, &call.token);
  service(self).app_root_ = root;
  return service(self).look_at_application(message, call);
}

int FakeMeshdService::on_import(sd_bus_message* message, void* self, sd_bus_error*) {
  const char* root = nullptr;
  Import call;
  std::uint16_t net_index = 1;
  sd_bus_message_read(message, "o", &root);
  call.uuid = read_key(message);
  call.device_key = read_key(message);
  call.net_key = read_key(message);
  sd_bus_message_read(message, "q", &net_index);
  demand_no_options(message);
  sd_bus_message_read(message, "uq", &call.iv_index, &call.address);
  EXPECT_EQ(net_index, 0);
  service(self).app_root_ = root;
  return service(self).look_at_application(message, call);
}

int FakeMeshdService::on_objects(sd_bus_message* reply, void* self, sd_bus_error*) {
  FakeMeshdService& fake = service(self);
  EXPECT_EQ(sd_bus_message_is_method_error(reply, nullptr), 0);
  EXPECT_STREQ(sd_bus_message_get_signature(reply, 1), "a{oa{sa{sv}}}");
  sd_bus_message_enter_container(reply, 'a', "{oa{sa{sv}}}");
  while (sd_bus_message_enter_container(reply, 'e', "oa{sa{sv}}") > 0) {
    fake.read_object(reply);
    sd_bus_message_exit_container(reply);
  }
  EXPECT_FALSE(fake.application.empty() || fake.element.empty() || fake.agent.empty());
  fake.meshd.call({fake.looking_, fake.waiting_.at(fake.looking_).call});
  return 0;
}

void FakeMeshdService::read_object(sd_bus_message* reply) {
  const char* path = nullptr;
  sd_bus_message_read(reply, "o", &path);
  sd_bus_message_enter_container(reply, 'a', "{sa{sv}}");
  while (sd_bus_message_enter_container(reply, 'e', "sa{sv}") > 0) {
    read_interface(reply, path);
    sd_bus_message_exit_container(reply);
  }
  sd_bus_message_exit_container(reply);
}

/// Checks that each interface occurs once, with all of its properties in their types.
void FakeMeshdService::read_interface(sd_bus_message* reply, const std::string& path) {
  const char* name = nullptr;
  sd_bus_message_read(reply, "s", &name);
  std::map<std::string, std::string> types;
  sd_bus_message_enter_container(reply, 'a', "{sv}");
  while (sd_bus_message_enter_container(reply, 'e', "sv") > 0) {
    const char *property = nullptr, *type = nullptr;
    char container = 0;
    sd_bus_message_read(reply, "s", &property);
    sd_bus_message_peek_type(reply, &container, &type);
    types[property] = type;
    sd_bus_message_skip(reply, "v");
    sd_bus_message_exit_container(reply);
  }
  sd_bus_message_exit_container(reply);
  const std::string interface = name;
  using Types = std::map<std::string, std::string>;
  const auto keep = [&](std::string& where, const Types& wanted) {
    EXPECT_EQ(where, "") << interface << " occurs twice";
    EXPECT_EQ(types, wanted) << interface;
    where = path;
  };
  if (interface == "org.bluez.mesh.Application1")
    keep(application, {{"CompanyID", "q"}, {"ProductID", "q"}, {"VersionID", "q"}, {"CRPL", "q"}});
  if (interface == "org.bluez.mesh.ProvisionAgent1") keep(agent, {{"Capabilities", "as"}});
  if (interface == "org.bluez.mesh.Element1")
    keep(element, {{"Index", "y"}, {"Models", "a(qa{sv})"}, {"VendorModels", "a(qqa{sv})"}});
}

int FakeMeshdService::on_leave(sd_bus_message* message, void* self, sd_bus_error*) {
  Leave call;
  sd_bus_message_read(message, "t", &call.token);
  return service(self).take(message, call);
}

int FakeMeshdService::on_import_subnet(sd_bus_message* message, void* self, sd_bus_error*) {
  std::uint16_t index = 1;
  sd_bus_message_read(message, "q", &index);
  EXPECT_EQ(index, 0);
  return service(self).take(message, ImportSubnet{read_key(message)});
}

int FakeMeshdService::on_import_app_key(sd_bus_message* message, void* self, sd_bus_error*) {
  std::uint16_t net_index = 1, app_index = 1;
  sd_bus_message_read(message, "qq", &net_index, &app_index);
  EXPECT_EQ(net_index + app_index, 0);
  return service(self).take(message, ImportAppKey{read_key(message)});
}

int FakeMeshdService::on_import_remote_node(sd_bus_message* message, void* self, sd_bus_error*) {
  ImportRemoteNode call;
  std::uint8_t count = 0;
  sd_bus_message_read(message, "qy", &call.address, &count);
  call.device_key = read_key(message);
  return service(self).take(message, call);
}

int FakeMeshdService::on_export_keys(sd_bus_message* message, void* self, sd_bus_error*) {
  return service(self).take(message, ExportKeys{});
}

int FakeMeshdService::on_scan(sd_bus_message* message, void* self, sd_bus_error*) {
  demand_no_options(message);
  return service(self).take(message, UnprovisionedScan{});
}

int FakeMeshdService::on_scan_cancel(sd_bus_message* message, void* self, sd_bus_error*) {
  return service(self).take(message, UnprovisionedScanCancel{});
}

/// Asks the agent for its capabilities first, and for the static OOB of a device that has one.
int FakeMeshdService::on_add_node(sd_bus_message* message, void* self, sd_bus_error*) {
  FakeMeshdService& fake = service(self);
  const Uuid uuid = read_key(message);
  demand_no_options(message);
  fake.looking_ = ++fake.last_number_;
  fake.waiting_[fake.looking_] = {SdBusMessage(sd_bus_message_ref(message)), AddNode{uuid}};
  SdBusMessage call = fake.call_to(fake.agent, "org.freedesktop.DBus.Properties", "GetAll");
  sd_bus_message_append(call.get(), "s", "org.bluez.mesh.ProvisionAgent1");
  fake.send(std::move(call), on_agent_properties);
  return 1;
}

int FakeMeshdService::on_agent_properties(sd_bus_message* reply, void* self, sd_bus_error*) {
  FakeMeshdService& fake = service(self);
  const char *name = nullptr, *capability = nullptr;
  fake.capabilities.clear();
  sd_bus_message_enter_container(reply, 'a', "{sv}");
  sd_bus_message_enter_container(reply, 'e', "sv");
  sd_bus_message_read(reply, "s", &name);
  sd_bus_message_enter_container(reply, 'v', "as");
  sd_bus_message_enter_container(reply, 'a', "s");
  while (sd_bus_message_read(reply, "s", &capability) > 0) fake.capabilities.insert(capability);
  EXPECT_STREQ(name, "Capabilities");
  const bool has_oob = std::ranges::any_of(
      fake.meshd.robots.devices, [](const auto& robot) { return !robot.static_oob.empty(); });
  if (!has_oob || !fake.capabilities.contains("static-oob")) {
    fake.meshd.call({fake.looking_, fake.waiting_.at(fake.looking_).call});
    return 0;
  }
  SdBusMessage call = fake.call_to(fake.agent, "org.bluez.mesh.ProvisionAgent1", "PromptStatic");
  sd_bus_message_append(call.get(), "s", "static-oob");
  fake.send(std::move(call), on_static_oob);
  return 0;
}

int FakeMeshdService::on_static_oob(sd_bus_message* reply, void* self, sd_bus_error*) {
  FakeMeshdService& fake = service(self);
  fake.prompted = read_octets(reply);
  fake.meshd.call({fake.looking_, fake.waiting_.at(fake.looking_).call});
  return 0;
}

int FakeMeshdService::on_send(sd_bus_message* message, void* self, sd_bus_error*) {
  const char* path = nullptr;
  Send call;
  sd_bus_message_read(message, "oqq", &path, &call.destination, &call.key);
  demand_no_options(message);
  call.payload = read_octets(message);
  EXPECT_EQ(path, service(self).element);
  return service(self).take(message, std::move(call));
}

int FakeMeshdService::on_dev_key_send(sd_bus_message* message, void* self, sd_bus_error*) {
  const char* path = nullptr;
  DevKeySend call;
  int is_remote = 0;
  std::uint16_t net_index = 1;
  sd_bus_message_read(message, "oqbq", &path, &call.destination, &is_remote, &net_index);
  demand_no_options(message);
  call.payload = read_octets(message);
  EXPECT_EQ(path, service(self).element);
  EXPECT_TRUE(is_remote == 1 && net_index == 0);
  return service(self).take(message, std::move(call));
}

int FakeMeshdService::get_addresses(sd_bus*, const char*, const char*, const char*,
                                    sd_bus_message* reply, void* self, sd_bus_error*) {
  const FakeNode* node = service(self).meshd.attached();
  return sd_bus_message_append(reply, "aq", 1, node ? int{node->address} : 0);
}

int FakeMeshdService::get_iv_index(sd_bus*, const char*, const char*, const char*,
                                   sd_bus_message* reply, void* self, sd_bus_error*) {
  const FakeNode* node = service(self).meshd.attached();
  return sd_bus_message_append(reply, "u", node ? node->iv_index : 0);
}

// --- Calls of the fake ---------------------------------------------------------------------------

SdBusMessage FakeMeshdService::call_to(const std::string& path, const char* interface,
                                       const char* member) {
  sd_bus_message* made = nullptr;
  EXPECT_GE(sd_bus_message_new_method_call(bus_.get(), &made, owner_.c_str(), path.c_str(),
                                           interface, member),
            0);
  return SdBusMessage(made);
}

void FakeMeshdService::note(const char* who, sd_bus_message* call) {
  const std::string types = sd_bus_message_get_signature(call, 1);
  calls.insert(std::string(who) + " " + sd_bus_message_get_interface(call) + "." +
               sd_bus_message_get_member(call) + (types.empty() ? "" : " " + types));
}

int FakeMeshdService::on_filter(sd_bus_message* message, void* self, sd_bus_error*) {
  if (sd_bus_message_is_method_call(message, nullptr, nullptr) > 0)
    service(self).note("gateway", message);
  return 0;
}

void FakeMeshdService::send(SdBusMessage message, sd_bus_message_handler_t done) {
  note("meshd", message.get());
  if (done == nullptr) {
    sd_bus_message_set_expect_reply(message.get(), 0);
    EXPECT_GE(sd_bus_send(bus_.get(), message.get(), nullptr), 0);
    return;
  }
  EXPECT_GE(sd_bus_call_async(bus_.get(), nullptr, message.get(), done, this, 0), 0);
}

void FakeMeshdService::say(MeshdEvent& event) {
  const char* const provisioner = "org.bluez.mesh.Provisioner1";
  const char* const element_interface = "org.bluez.mesh.Element1";
  std::visit(
      overloaded{
          [&](const MeshdAnswer& what) { answer(what); },
          [&](const JoinComplete& complete) {
            SdBusMessage call = call_to(application, "org.bluez.mesh.Application1", "JoinComplete");
            sd_bus_message_append(call.get(), "t", complete.token);
            send(std::move(call), on_token_taken);
          },
          [&](const ScanResult& result) {
            SdBusMessage call = call_to(application, provisioner, "ScanResult");
            sd_bus_message_append(call.get(), "n", int{result.rssi});
            append_octets(call.get(), result.data);
            sd_bus_message_append(call.get(), "a{sv}", 0);
            send(std::move(call), nullptr);
          },
          [&](const RequestProvData& wanted) {
            SdBusMessage call = call_to(application, provisioner, "RequestProvData");
            sd_bus_message_append(call.get(), "y", int{wanted.elements});
            send(std::move(call), on_prov_data);
          },
          [&](const AddNodeComplete& added) {
            SdBusMessage call = call_to(application, provisioner, "AddNodeComplete");
            append_octets(call.get(), Bytes(added.uuid.begin(), added.uuid.end()));
            sd_bus_message_append(call.get(), "qy", int{added.address}, 1);
            send(std::move(call), nullptr);
          },
          [&](const AddNodeFailed& failed) {
            SdBusMessage call = call_to(application, provisioner, "AddNodeFailed");
            append_octets(call.get(), Bytes(failed.uuid.begin(), failed.uuid.end()));
            sd_bus_message_append(call.get(), "s", failed.why.c_str());
            send(std::move(call), nullptr);
          },
          [&](const AppMessage& message) {
            SdBusMessage call = call_to(element, element_interface, "MessageReceived");
            sd_bus_message_append(call.get(), "qqv", int{message.source}, int{message.key}, "q", 1);
            append_octets(call.get(), message.payload);
            send(std::move(call), nullptr);
          },
          [&](const DevKeyMessage& message) {
            SdBusMessage call = call_to(element, element_interface, "DevKeyMessageReceived");
            sd_bus_message_append(call.get(), "qbq", int{message.source}, int{message.is_remote},
                                  0);
            append_octets(call.get(), message.payload);
            send(std::move(call), nullptr);
          },
          [](const auto&) { FAIL() << "meshd does not say that itself"; },
      },
      event);
}

void FakeMeshdService::answer(const MeshdAnswer& what) {
  const auto found = waiting_.find(what.number);
  ASSERT_NE(found, waiting_.end());
  const Waiting waiting = std::move(found->second);
  waiting_.erase(found);
  if (!what.is_success())
    return void(
        sd_bus_reply_method_errorf(waiting.message.get(), what.error.c_str(), "%s", "refused"));
  sd_bus_message* made = nullptr;
  sd_bus_message_new_method_return(waiting.message.get(), &made);
  const SdBusMessage reply(made);
  if (std::holds_alternative<Attach>(waiting.call)) {
    const FakeNode& node = *meshd.attached();
    const std::string path = node_prefix + to_hex(Bytes(node.uuid.begin(), node.uuid.end()));
    sd_bus_add_object_vtable(bus_.get(), nullptr, path.c_str(), "org.bluez.mesh.Management1",
                             Objects::management, this);
    sd_bus_add_object_vtable(bus_.get(), nullptr, path.c_str(), "org.bluez.mesh.Node1",
                             Objects::node, this);
    sd_bus_message_append(made, "oa(ya(qa{sv}))", path.c_str(), 0);
  }
  if (std::holds_alternative<ExportKeys>(waiting.call)) {
    sd_bus_message_open_container(made, 'a', "{sv}");
    sd_bus_message_append(made, "{sv}", "NetKeys", "a(qaya{sv})", 0);
    sd_bus_message_open_container(made, 'e', "sv");
    sd_bus_message_append(made, "s", "DevKeys");
    sd_bus_message_open_container(made, 'v', "a(qay)");
    sd_bus_message_open_container(made, 'a', "(qay)");
    for (const auto& [address, key] : what.device_keys) {
      sd_bus_message_open_container(made, 'r', "qay");
      sd_bus_message_append(made, "q", int{address});
      append_octets(made, Bytes(key.begin(), key.end()));
      sd_bus_message_close_container(made);
    }
    for (int depth = 0; depth < 4; ++depth) sd_bus_message_close_container(made);
  }
  EXPECT_GE(sd_bus_send(bus_.get(), made, nullptr), 0);
}

/// Like the real one: an application that answers with an error has not stored the token.
int FakeMeshdService::on_token_taken(sd_bus_message* reply, void* self, sd_bus_error*) {
  EXPECT_EQ(sd_bus_message_is_method_error(reply, nullptr), 0);
  service(self).meshd.accept_token();
  return 0;
}

int FakeMeshdService::on_prov_data(sd_bus_message* reply, void* self, sd_bus_error*) {
  std::uint16_t net_index = 1, address = 0;
  const bool is_refused = sd_bus_message_is_method_error(reply, nullptr) > 0;
  if (!is_refused) {
    sd_bus_message_read(reply, "qq", &net_index, &address);
    EXPECT_EQ(net_index, 0);
  }
  service(self).meshd.give_address(is_refused ? std::nullopt : std::optional(address));
  return 0;
}

}  // namespace slamgw::ble
