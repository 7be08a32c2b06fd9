// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_bluez/io/meshd_bus.hpp"

#include <algorithm>
#include <concepts>
#include <cstring>
#include <utility>

#include "adapters/ble_mesh_bluez/meshd_radio.hpp"

namespace slamgw::ble {
namespace {

constexpr const char* service = "org.bluez.mesh";
constexpr const char* network_path = "/org/bluez/mesh";
constexpr const char* network = "org.bluez.mesh.Network1";
constexpr const char* node = "org.bluez.mesh.Node1";
constexpr const char* management = "org.bluez.mesh.Management1";
constexpr const char* properties = "org.freedesktop.DBus.Properties";
constexpr const char* abort_error = "org.bluez.mesh.Error.Abort";

constexpr const char* root = "/org/slam_gateway";
constexpr const char* application = "/org/slam_gateway/application";
constexpr const char* agent = "/org/slam_gateway/agent";
constexpr const char* element = "/org/slam_gateway/element";

constexpr std::uint16_t index_0 = 0;  // of both keys
constexpr bool is_remote = true;
constexpr std::uint8_t one_element = 1;

struct ObjectPath {
  const char* text;
};
struct NoOptions {};

// Arguments of calls.
void append(sd_bus_message* message, ObjectPath path) {
  sd_bus_message_append(message, "o", path.text);
}
void append(sd_bus_message* message, const char* text) {
  sd_bus_message_append(message, "s", text);
}
void append(sd_bus_message* message, bool value) {
  sd_bus_message_append(message, "b", int{value});
}
void append(sd_bus_message* message, std::unsigned_integral auto number) {
  constexpr std::size_t size = sizeof(number);
  constexpr char type = size == 1 ? 'y' : size == 2 ? 'q' : size == 4 ? 'u' : 't';
  sd_bus_message_append_basic(message, type, &number);
}
void append(sd_bus_message* message, ByteView bytes) {
  sd_bus_message_append_array(message, 'y', bytes.data(), bytes.size());
}
void append(sd_bus_message* message, NoOptions) { sd_bus_message_append(message, "a{sv}", 0); }

/// Makes the D-Bus messages of calls to meshd.
struct Composer {
  const BusConnection& connection;
  const char* node_path;

  SdBusMessage operator()(const Attach& call) const {
    return compose(network_path, network, "Attach", ObjectPath{root}, call.token);
  }
  SdBusMessage operator()(const Import& call) const {
    return compose(network_path, network, "Import", ObjectPath{root}, call.uuid, call.device_key,
                   call.net_key, index_0, NoOptions{}, call.iv_index, call.address);
  }
  SdBusMessage operator()(const Leave& call) const {
    return compose(network_path, network, "Leave", call.token);
  }
  SdBusMessage operator()(const ImportSubnet& call) const {
    return compose(node_path, management, "ImportSubnet", index_0, call.net_key);
  }
  SdBusMessage operator()(const ImportAppKey& call) const {
    return compose(node_path, management, "ImportAppKey", index_0, index_0, call.app_key);
  }
  SdBusMessage operator()(const ImportRemoteNode& call) const {
    return compose(node_path, management, "ImportRemoteNode", call.address, one_element,
                   call.device_key);
  }
  SdBusMessage operator()(const ExportKeys&) const {
    return compose(node_path, management, "ExportKeys");
  }
  SdBusMessage operator()(const UnprovisionedScan&) const {
    return compose(node_path, management, "UnprovisionedScan", NoOptions{});
  }
  SdBusMessage operator()(const UnprovisionedScanCancel&) const {
    return compose(node_path, management, "UnprovisionedScanCancel");
  }
  SdBusMessage operator()(const AddNode& call) const {
    return compose(node_path, management, "AddNode", call.uuid, NoOptions{});
  }
  SdBusMessage operator()(const Send& call) const {
    return compose(node_path, node, "Send", ObjectPath{element}, call.destination, call.key,
                   NoOptions{}, call.payload);
  }
  SdBusMessage operator()(const DevKeySend& call) const {
    return compose(node_path, node, "DevKeySend", ObjectPath{element}, call.destination, is_remote,
                   index_0, NoOptions{}, call.payload);
  }
  SdBusMessage operator()(const GetAddresses&) const {
    return compose(node_path, properties, "Get", node, "Addresses");
  }
  SdBusMessage operator()(const GetIvIndex&) const {
    return compose(node_path, properties, "Get", node, "IvIndex");
  }

 private:
  template <class... Arguments>
  SdBusMessage compose(const char* path, const char* interface, const char* member,
                       const Arguments&... arguments) const {
    SdBusMessage message = connection.call(path, interface, member);
    (append(message.get(), arguments), ...);
    return message;
  }
};

Bytes read_bytes(sd_bus_message* message) {
  const void* data = nullptr;
  std::size_t size = 0;
  if (sd_bus_message_read_array(message, 'y', &data, &size) < 0 || size == 0) return {};
  const auto* const first = static_cast<const std::uint8_t*>(data);
  return {first, first + size};
}

/// Reads an array of `size` octets; nothing when it has another length.
template <std::size_t size>
std::optional<std::array<std::uint8_t, size>> read_array(sd_bus_message* message) {
  const Bytes bytes = read_bytes(message);
  std::array<std::uint8_t, size> array{};
  if (bytes.size() != size) return std::nullopt;
  std::ranges::copy(bytes, array.begin());
  return array;
}

int bad_arguments(sd_bus_error* error) {
  return sd_bus_error_set(error, SD_BUS_ERROR_INVALID_ARGS, "");
}

void read_device_keys(sd_bus_message* reply, std::map<std::uint16_t, Key>& keys) {
  if (sd_bus_message_enter_container(reply, 'v', "a(qay)") <= 0) return;
  if (sd_bus_message_enter_container(reply, 'a', "(qay)") <= 0) return;
  while (sd_bus_message_enter_container(reply, 'r', "qay") > 0) {
    std::uint16_t address = 0;
    sd_bus_message_read(reply, "q", &address);
    if (const auto key = read_array<sizeof(Key)>(reply)) keys[address] = *key;
    sd_bus_message_exit_container(reply);
  }
  sd_bus_message_exit_container(reply);
  sd_bus_message_exit_container(reply);
}

void read_exported_keys(sd_bus_message* reply, std::map<std::uint16_t, Key>& keys) {
  if (sd_bus_message_enter_container(reply, 'a', "{sv}") <= 0) return;
  while (sd_bus_message_enter_container(reply, 'e', "sv") > 0) {
    const char* name = nullptr;
    sd_bus_message_read(reply, "s", &name);
    if (name != nullptr && std::strcmp(name, "DevKeys") == 0)
      read_device_keys(reply, keys);
    else
      sd_bus_message_skip(reply, "v");
    sd_bus_message_exit_container(reply);
  }
}

std::uint16_t read_first_address(sd_bus_message* reply) {
  const void* data = nullptr;
  std::size_t size = 0;
  std::uint16_t address = 0;
  if (sd_bus_message_enter_container(reply, 'v', "aq") > 0 &&
      sd_bus_message_read_array(reply, 'q', &data, &size) >= 0 && size >= sizeof(address))
    std::memcpy(&address, data, sizeof(address));
  return address;
}

// Properties of the gateway's node. meshd compares its composition at each Attach.

template <std::uint16_t value>
int get_u16(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply, void*,
            sd_bus_error*) {
  return sd_bus_message_append(reply, "q", int{value});
}
int get_element_index(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply, void*,
                      sd_bus_error*) {
  return sd_bus_message_append(reply, "y", 0);
}
/// The configuration client speaks with nodes under their device keys. The remote provisioning
/// client is meshd's own, which scans; meshd forgets it at its restart unless the application names
/// it.
int get_models(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply, void*,
               sd_bus_error*) {
  constexpr int configuration_client = 0x0001;
  constexpr int remote_provisioning_client = 0x0005;
  return sd_bus_message_append(reply, "a(qa{sv})", 2, configuration_client, 0,
                               remote_provisioning_client, 0);
}
int get_vendor_models(sd_bus*, const char*, const char*, const char*, sd_bus_message* reply, void*,
                      sd_bus_error*) {
  return sd_bus_message_append(reply, "a(qqa{sv})", 1, int{*gateway_model.company},
                               int{gateway_model.number}, 0);
}
int do_nothing(sd_bus_message* message, void*, sd_bus_error*) {
  return sd_bus_reply_method_return(message, "");
}

}  // namespace

struct MeshdBus::Objects {
  static constexpr std::uint64_t constant = SD_BUS_VTABLE_PROPERTY_CONST;
  static constexpr std::uint64_t open = SD_BUS_VTABLE_UNPRIVILEGED;
  static constexpr sd_bus_vtable application[] = {
      SD_BUS_VTABLE_START(0), SD_BUS_METHOD("JoinComplete", "t", "", on_join_complete, open),
      SD_BUS_PROPERTY("CompanyID", "q", get_u16<*gateway_model.company>, 0, constant),
      SD_BUS_PROPERTY("ProductID", "q", get_u16<1>, 0, constant),
      SD_BUS_PROPERTY("VersionID", "q", get_u16<1>, 0, constant),
      // Length of the replay list that meshd keeps for the node; without it, 100.
      SD_BUS_PROPERTY("CRPL", "q", get_u16<last_unicast_address>, 0, constant), SD_BUS_VTABLE_END};
  static constexpr sd_bus_vtable provisioner[] = {
      SD_BUS_VTABLE_START(0),
      SD_BUS_METHOD("ScanResult", "naya{sv}", "", on_scan_result, open),
      SD_BUS_METHOD("RequestProvData", "y", "qq", on_prov_data_wanted, open),
      SD_BUS_METHOD("AddNodeComplete", "ayqy", "", on_node_added, open),
      SD_BUS_METHOD("AddNodeFailed", "ays", "", on_node_failed, open),
      SD_BUS_VTABLE_END};
  static constexpr sd_bus_vtable agent[] = {
      SD_BUS_VTABLE_START(0), SD_BUS_METHOD("PromptStatic", "s", "ay", on_prompt_static, open),
      SD_BUS_METHOD("Cancel", "", "", do_nothing, open),
      SD_BUS_PROPERTY("Capabilities", "as", get_capabilities, 0, constant), SD_BUS_VTABLE_END};
  static constexpr sd_bus_vtable element[] = {
      SD_BUS_VTABLE_START(0),
      SD_BUS_METHOD("MessageReceived", "qqvay", "", on_message, open),
      SD_BUS_METHOD("DevKeyMessageReceived", "qbqay", "", on_device_key_message, open),
      SD_BUS_METHOD("UpdateModelConfiguration", "qa{sv}", "", do_nothing, open),
      SD_BUS_PROPERTY("Index", "y", get_element_index, 0, constant),
      SD_BUS_PROPERTY("Models", "a(qa{sv})", get_models, 0, constant),
      SD_BUS_PROPERTY("VendorModels", "a(qqa{sv})", get_vendor_models, 0, constant),
      SD_BUS_VTABLE_END};
};

MeshdBus::MeshdBus(boost::asio::io_context& io, std::string address, std::optional<Key> static_oob,
                   std::function<void(MeshdEvent)> on_event)
    : static_oob_(static_oob),
      on_event_(std::move(on_event)),
      connection_(io, std::move(address), service,
                  {[this](sd_bus* bus) { return offer_objects(bus); },
                   [this](const std::string& fault) { on_meshd(fault); }}) {}

// --- The connection ------------------------------------------------------------------------------

int MeshdBus::offer_objects(sd_bus* bus) {
  const auto add = [&](const char* path, const char* interface, const sd_bus_vtable* table) {
    return sd_bus_add_object_vtable(bus, nullptr, path, interface, table, this);
  };
  return std::min({sd_bus_add_filter(bus, nullptr, on_filter, this),
                   sd_bus_add_object_manager(bus, nullptr, root),
                   add(application, "org.bluez.mesh.Application1", Objects::application),
                   add(application, "org.bluez.mesh.Provisioner1", Objects::provisioner),
                   add(agent, "org.bluez.mesh.ProvisionAgent1", Objects::agent),
                   add(element, "org.bluez.mesh.Element1", Objects::element)});
}

void MeshdBus::close() {
  forget_calls();
  connection_.close();
}

void MeshdBus::forget_calls() {
  pending_.clear();
  join_complete_.reset();
  prov_data_request_.reset();
}

void MeshdBus::on_meshd(const std::string& fault) {
  forget_calls();
  if (!connection_.owner().empty()) return on_event_(MeshdCame{});
  on_event_(MeshdGone{fault.empty() ? "bluetooth-meshd is not running; see slam-gatewayctl doctor"
                                    : fault});
}

/// Only meshd may call the gateway's objects.
int MeshdBus::on_filter(sd_bus_message* message, void* bus, sd_bus_error*) {
  const char* const sender = sd_bus_message_get_sender(message);
  if (sd_bus_message_is_method_call(message, nullptr, nullptr) <= 0) return 0;
  if (sender != nullptr && static_cast<MeshdBus*>(bus)->connection_.owner() == sender) return 0;
  const int error =
      sd_bus_reply_method_errorf(message, SD_BUS_ERROR_ACCESS_DENIED, "for bluetooth-meshd only");
  return error < 0 ? error : 1;
}

// --- Calls to meshd ------------------------------------------------------------------------------

void MeshdBus::perform(const MeshdRequest& request) {
  if (!connection_.bus()) return;
  std::visit(overloaded{
                 [this](const CallMeshd& wanted) { make_call(wanted); },
                 [this](const AcceptToken&) {
                   if (join_complete_) sd_bus_reply_method_return(join_complete_.get(), "");
                   join_complete_.reset();
                 },
                 [this](const GiveAddress& given) { answer(prov_data_request_, given); },
                 [this](const Reconnect&) {
                   forget_calls();
                   connection_.reopen();
                 },
             },
             request);
  connection_.watch();
}

void MeshdBus::make_call(const CallMeshd& wanted) {
  const auto entry =
      pending_.emplace(wanted.number, Pending{*this, wanted.number, wanted.call}).first;
  Pending& pending = entry->second;
  const SdBusMessage message = std::visit(Composer{connection_, node_path_.c_str()}, wanted.call);
  sd_bus_slot* slot = nullptr;
  const int error =
      sd_bus_call_async(connection_.bus(), &slot, message.get(), on_reply, &pending, 0);
  pending.slot.reset(slot);
  if (error >= 0) return;
  pending_.erase(entry);
  connection_.post([this, number = wanted.number, error] {
    on_event_(MeshdAnswer{.number = number, .error = "D-Bus", .why = std::strerror(-error)});
  });
}

void MeshdBus::answer(SdBusMessage& waiting, const GiveAddress& given) {
  if (!waiting) return;
  if (given.address)
    sd_bus_reply_method_return(waiting.get(), "qq", index_0, *given.address);
  else
    sd_bus_reply_method_errorf(waiting.get(), abort_error, "refused");
  waiting.reset();
}

int MeshdBus::on_reply(sd_bus_message* message, void* pending, sd_bus_error*) {
  const Pending& call = *static_cast<Pending*>(pending);
  MeshdBus& self = call.bus;
  MeshdAnswer answer{.number = call.number};
  if (const sd_bus_error* const error = sd_bus_message_get_error(message)) {
    answer.error = error->name != nullptr ? error->name : "D-Bus";
    answer.why = error->message != nullptr ? error->message : "";
  } else {
    self.read_answer(message, call.call, answer);
  }
  self.pending_.erase(answer.number);
  self.on_event_(std::move(answer));
  return 0;
}

void MeshdBus::read_answer(sd_bus_message* reply, const MeshdCall& call, MeshdAnswer& answer) {
  std::visit(overloaded{
                 [&](const Attach&) {
                   const char* path = "";
                   sd_bus_message_read(reply, "o", &path);
                   node_path_ = path;
                 },
                 [&](const ExportKeys&) { read_exported_keys(reply, answer.device_keys); },
                 [&](const GetAddresses&) { answer.address = read_first_address(reply); },
                 [&](const GetIvIndex&) { sd_bus_message_read(reply, "v", "u", &answer.iv_index); },
                 [](const auto&) {},
             },
             call);
}

// --- Calls by meshd ------------------------------------------------------------------------------

int MeshdBus::on_join_complete(sd_bus_message* message, void* bus, sd_bus_error*) {
  MeshdBus& self = *static_cast<MeshdBus*>(bus);
  JoinComplete complete;
  sd_bus_message_read(message, "t", &complete.token);
  self.join_complete_.reset(sd_bus_message_ref(message));
  self.on_event_(complete);
  return 1;
}

int MeshdBus::on_scan_result(sd_bus_message* message, void* bus, sd_bus_error*) {
  ScanResult result;
  sd_bus_message_read(message, "n", &result.rssi);
  result.data = read_bytes(message);
  static_cast<MeshdBus*>(bus)->on_event_(std::move(result));
  return sd_bus_reply_method_return(message, "");
}

int MeshdBus::on_prov_data_wanted(sd_bus_message* message, void* bus, sd_bus_error*) {
  MeshdBus& self = *static_cast<MeshdBus*>(bus);
  RequestProvData wanted;
  sd_bus_message_read(message, "y", &wanted.elements);
  self.prov_data_request_.reset(sd_bus_message_ref(message));
  self.on_event_(wanted);
  return 1;
}

int MeshdBus::on_node_added(sd_bus_message* message, void* bus, sd_bus_error* error) {
  const auto uuid = read_array<sizeof(Uuid)>(message);
  std::uint16_t address = 0;
  if (!uuid || sd_bus_message_read(message, "q", &address) < 0) return bad_arguments(error);
  static_cast<MeshdBus*>(bus)->on_event_(AddNodeComplete{*uuid, address});
  return sd_bus_reply_method_return(message, "");
}

int MeshdBus::on_node_failed(sd_bus_message* message, void* bus, sd_bus_error* error) {
  const auto uuid = read_array<sizeof(Uuid)>(message);
  const char* why = "";
  if (!uuid || sd_bus_message_read(message, "s", &why) < 0) return bad_arguments(error);
  static_cast<MeshdBus*>(bus)->on_event_(AddNodeFailed{*uuid, why});
  return sd_bus_reply_method_return(message, "");
}

int MeshdBus::on_message(sd_bus_message* message, void* bus, sd_bus_error*) {
  AppMessage received;
  sd_bus_message_read(message, "qq", &received.source, &received.key);
  sd_bus_message_skip(message, "v");
  received.payload = read_bytes(message);
  static_cast<MeshdBus*>(bus)->on_event_(std::move(received));
  return sd_bus_reply_method_return(message, "");
}

int MeshdBus::on_device_key_message(sd_bus_message* message, void* bus, sd_bus_error*) {
  DevKeyMessage received;
  int is_from_remote = 0;
  std::uint16_t net_index = 0;
  sd_bus_message_read(message, "qbq", &received.source, &is_from_remote, &net_index);
  received.is_remote = is_from_remote != 0;
  received.payload = read_bytes(message);
  static_cast<MeshdBus*>(bus)->on_event_(std::move(received));
  return sd_bus_reply_method_return(message, "");
}

int MeshdBus::on_prompt_static(sd_bus_message* message, void* bus, sd_bus_error* error) {
  MeshdBus& self = *static_cast<MeshdBus*>(bus);
  const auto& oob = self.static_oob_;
  if (!oob) return sd_bus_error_set(error, abort_error, "no static OOB is configured");
  self.on_event_(StaticOobGiven{});
  sd_bus_message* made = nullptr;
  sd_bus_message_new_method_return(message, &made);
  const SdBusMessage reply(made);
  append(made, *oob);
  return sd_bus_send(nullptr, made, nullptr);
}

int MeshdBus::get_capabilities(sd_bus*, const char*, const char*, const char*,
                               sd_bus_message* reply, void* bus, sd_bus_error*) {
  if (static_cast<MeshdBus*>(bus)->static_oob_)
    return sd_bus_message_append(reply, "as", 1, "static-oob");
  return sd_bus_message_append(reply, "as", 0);
}

}  // namespace slamgw::ble
