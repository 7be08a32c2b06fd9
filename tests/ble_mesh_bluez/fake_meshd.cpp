// SPDX-License-Identifier: Apache-2.0
#include "tests/ble_mesh_bluez/fake_meshd.hpp"

#include <algorithm>
#include <utility>

#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

constexpr const char* not_found = "org.bluez.mesh.Error.NotFound";
constexpr const char* already_exists = "org.bluez.mesh.Error.AlreadyExists";
constexpr const char* invalid_arguments = "org.bluez.mesh.Error.InvalidArguments";
constexpr const char* not_authorized = "org.bluez.mesh.Error.NotAuthorized";
constexpr const char* does_not_exist = "org.bluez.mesh.Error.DoesNotExist";
constexpr std::size_t max_message = 380;

template <class Array>
Bytes bytes_of(const Array& array) {
  return Bytes(array.begin(), array.end());
}
Uuid uuid_of(const Bytes& bytes) {
  Uuid uuid{};
  std::ranges::copy(bytes, uuid.begin());
  return uuid;
}
Key key_of(const Bytes& bytes) { return uuid_of(bytes); }

}  // namespace

void FakeMeshd::call(const CallMeshd& wanted) {
  if (does_not_answer) return;
  MeshdAnswer answer{.number = wanted.number};
  if (is_without_controller)
    answer.error = "org.freedesktop.DBus.Error.NotFound";
  else
    std::visit([&](const auto& call) { take(call, answer); }, wanted.call);
  const bool is_import = std::holds_alternative<Import>(wanted.call) && answer.is_success();
  events.push_back(std::move(answer));
  if (is_import && !does_not_complete) events.push_back(JoinComplete{*unaccepted_});
}

FakeNode* FakeMeshd::node(MeshdAnswer& answer) {
  if (attached_) return &nodes.at(*attached_);
  answer.error = not_authorized;
  return nullptr;
}

// --- Network1 ------------------------------------------------------------------------------------

void FakeMeshd::take(const Attach& call, MeshdAnswer& answer) {
  const auto found = nodes.find(call.token);
  if (found == nodes.end() || !found->second.is_final) {
    answer.error = not_found;
  } else if (attached_ == call.token) {
    answer.error = already_exists;
  } else {
    attached_ = call.token;
  }
}

void FakeMeshd::take(const Import& call, MeshdAnswer& answer) {
  const bool is_version_4 = (call.uuid[6] & 0xf0) == 0x40 && (call.uuid[8] & 0xc0) == 0x80;
  demand(call.device_key != Key{}, "a device key of zeros is none");
  if (!is_version_4 || call.address == 0 || call.address > last_unicast_address)
    return void(answer.error = invalid_arguments);
  for (const auto& [token, node] : nodes) {
    if (node.uuid == call.uuid) return void(answer.error = already_exists);
    demand(node.address != call.address, "an address is used once");
  }
  ++imports;
  unaccepted_ = ++last_token_;
  nodes[last_token_] = {.uuid = call.uuid,
                        .device_key = call.device_key,
                        .net_key = call.net_key,
                        .iv_index = call.iv_index,
                        .address = call.address};
}

void FakeMeshd::accept_token() {
  demand(unaccepted_.has_value(), "JoinComplete is answered once");
  if (unaccepted_) nodes.at(*std::exchange(unaccepted_, std::nullopt)).is_final = true;
}

void FakeMeshd::take(const Leave& call, MeshdAnswer& answer) {
  if (nodes.erase(call.token) == 0) answer.error = not_found;
  if (attached_ == call.token) attached_.reset();
}

void FakeMeshd::restart() {
  std::erase_if(nodes, [](const auto& entry) { return !entry.second.is_final; });
  attached_.reset();
  unaccepted_.reset();
  is_scanning_ = false;
  joining_.reset();
  events.clear();
}

// --- Management1 ---------------------------------------------------------------------------------

void FakeMeshd::take(const ImportSubnet& call, MeshdAnswer& answer) {
  FakeNode* own = node(answer);
  if (own == nullptr) return;
  if (has_other_keys || (own->subnet && *own->subnet != call.net_key))
    return void(answer.error = already_exists);
  demand(call.net_key == own->net_key, "the subnet has the node's key");
  own->subnet = call.net_key;
}

void FakeMeshd::take(const ImportAppKey& call, MeshdAnswer& answer) {
  FakeNode* own = node(answer);
  if (own == nullptr) return;
  if (!own->subnet) return void(answer.error = does_not_exist);
  if (own->app_key && *own->app_key != call.app_key) return void(answer.error = already_exists);
  own->app_key = call.app_key;
}

void FakeMeshd::take(const ImportRemoteNode& call, MeshdAnswer& answer) {
  FakeNode* own = node(answer);
  if (own != nullptr) own->remote_keys[call.address] = call.device_key;
}

void FakeMeshd::take(const ExportKeys&, MeshdAnswer& answer) {
  if (const FakeNode* own = node(answer)) answer.device_keys = own->remote_keys;
}

void FakeMeshd::take(const UnprovisionedScan&, MeshdAnswer& answer) {
  if (node(answer) == nullptr) return;
  is_scanning_ = true;
  reported_.clear();
  beacon();
}

void FakeMeshd::take(const UnprovisionedScanCancel&, MeshdAnswer& answer) {
  if (node(answer) != nullptr) is_scanning_ = false;
}

void FakeMeshd::beacon() {
  if (!is_scanning_) return;
  for (const FakeDevice& robot : robots.devices)
    if (robot.address == 0 && reported_.insert(robot.uuid).second)
      events.push_back(ScanResult{rssi, robot.uuid + hex("00 00")});
}

void FakeMeshd::take(const AddNode& call, MeshdAnswer& answer) {
  const FakeNode* own = node(answer);
  if (own == nullptr) return;
  demand(own->subnet.has_value(), "a device joins a subnet of the database");
  demand(!joining_, "one device joins at a time");  // the real one does not answer then
  is_scanning_ = false;
  if (!fails_to_join.empty()) {
    events.push_back(AddNodeFailed{call.uuid, std::exchange(fails_to_join, "")});
    return;
  }
  joining_ = bytes_of(call.uuid);
  events.push_back(RequestProvData{1});
}

void FakeMeshd::give_address(std::optional<std::uint16_t> address) {
  if (!joining_) return void(broken_rules.insert("RequestProvData is answered once"));
  const Bytes uuid = *std::exchange(joining_, std::nullopt);
  const auto robot = std::ranges::find(robots.devices, uuid, &FakeDevice::uuid);
  if (!address || robot == robots.devices.end())
    return events.push_back(AddNodeFailed{uuid_of(uuid), "timeout"});
  robot->address = *address;
  robot->device_key = Bytes(16, static_cast<std::uint8_t>(*address));
  FakeNode& own = nodes.at(*attached_);
  robot->net_key = bytes_of(*own.subnet);
  own.remote_keys[*address] = key_of(robot->device_key);
  events.push_back(AddNodeComplete{uuid_of(uuid), *address});
}

// --- Node1 ---------------------------------------------------------------------------------------

void FakeMeshd::take(const Send& call, MeshdAnswer& answer) {
  FakeNode* own = node(answer);
  if (own == nullptr) return;
  // The real one asks for the key alone.
  if (!own->own_app_key || !own->is_bound || call.key != 0)
    return void(answer.error = not_authorized);
  if (call.payload.empty() || call.payload.size() > max_message || call.destination == 0)
    return void(answer.error = invalid_arguments);
  ++own->sequence_number;
  if (own->subscriptions.contains(call.destination))
    events.push_back(AppMessage{own->address, 0, call.payload});
  sent.push_back(call);
}

void FakeMeshd::take(const DevKeySend& call, MeshdAnswer& answer) {
  FakeNode* own = node(answer);
  if (own == nullptr) return;
  const auto key = own->remote_keys.find(call.destination);
  if (key == own->remote_keys.end()) return void(answer.error = not_found);
  if (call.payload.empty() || call.payload.size() > max_message)
    return void(answer.error = invalid_arguments);
  if (call.destination == own->address && own->is_replaying) return;
  if (call.destination == own->address)
    return key->second == own->device_key ? configure_own(*own, call.payload) : void();
  ++own->sequence_number;
  FakeDevice* robot = robots.at(call.destination);
  if (robot == nullptr || robot->device_key != bytes_of(key->second)) return;
  if (!robot->hears(bytes_of(own->net_key))) return;
  const Bytes reply = robots.answer(*robot, to_hex(call.payload));
  if (!reply.empty()) events.push_back(DevKeyMessage{robot->address, true, reply});
}

/// Answers as the configuration server of the own node, before the call is answered.
void FakeMeshd::configure_own(FakeNode& own, const Bytes& request) {
  const auto from = [&](std::ptrdiff_t first) {
    return Bytes(request.begin() + first, request.end());
  };
  const auto say = [&](const Bytes& reply) {
    events.push_back(DevKeyMessage{own.address, false, reply});
  };
  const std::string text = to_hex(request);
  if (text.starts_with("00")) {
    own.own_app_key = key_of(from(4));
    say(hex("80 03 00 00 00 00"));
  } else if (text.starts_with("803d")) {
    own.is_bound = own.own_app_key.has_value();
    say(hex(own.is_bound ? "80 3e 00" : "80 3e 03") + from(2));
  } else if (text.starts_with("800d")) {
    own.ttl = request.back();
    say(hex("80 0e") + from(2));
  } else if (text.starts_with("8024")) {
    own.transmit = request.back();
    say(hex("80 25") + from(2));
  } else if (text.starts_with("801d")) {
    own.subscriptions.clear();
    say(hex("80 1f 00") + Bytes(request.begin() + 2, request.begin() + 4) + hex("00 00") + from(4));
  } else if (text.starts_with("801b")) {
    own.subscriptions.insert(static_cast<std::uint16_t>(request[4] | request[5] << 8));
    say(hex("80 1f 00") + from(2));
  } else if (text.starts_with("8045")) {
    say(hex("80 44 00 00 00"));
  } else if (text.starts_with("01")) {
    say(hex("80 03 00 00 00 00"));
  } else {
    broken_rules.insert("the node knows no such message: " + text);
  }
}

void FakeMeshd::take(const GetAddresses&, MeshdAnswer& answer) {
  if (const FakeNode* own = node(answer)) answer.address = own->address;
}

void FakeMeshd::take(const GetIvIndex&, MeshdAnswer& answer) {
  if (const FakeNode* own = node(answer)) answer.iv_index = own->iv_index;
}

void FakeMeshd::say(std::uint16_t source, Bytes payload) {
  if (attached_) events.push_back(AppMessage{source, 0, std::move(payload)});
}

}  // namespace slamgw::ble
