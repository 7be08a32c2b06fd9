// SPDX-License-Identifier: Apache-2.0
#include "tests/ble_mesh_usb_cdc/fake_devices.hpp"

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_session.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/serial_frame.hpp"

namespace slamgw::ble {
namespace {

constexpr std::uint16_t first_handle = 8;

/// The devices' key pair.
const KeyPair& device_pair() {
  static const KeyPair pair = [] {
    std::array<std::uint8_t, 32> private_key{};
    private_key.fill(0x42);
    return *key_pair_of(private_key);
  }();
  return pair;
}

}  // namespace

FakeDevice& FakeDevices::add(std::uint8_t number_of_device) {
  FakeDevice device;
  device.uuid = hex("736c616d") + Bytes(12, number_of_device);
  device.composition = hex("00 59 00 01 00 01 00 28 00 00 00 00 00 04 03") +
                       hex("00 00 02 00 00 10 01 10 59 00 04 00 59 00 06 00 59 00 09 00");
  devices.push_back(std::move(device));
  return devices.back();
}

FakeDevice* FakeDevices::at(std::uint16_t address) {
  const auto found = std::ranges::find(devices, address, &FakeDevice::address);
  return found == devices.end() ? nullptr : &*found;
}

std::optional<Bytes> FakeDevices::execute(std::uint8_t opcode, ByteView params) {
  switch (opcode) {
    case 0x61: is_scanning = true; return response(opcode, 0);
    case 0x62: is_scanning = false; return response(opcode, 0);
    case 0x63: return provision(params);
    case 0x66:
      if (joining_ == nullptr) return response(opcode, 0x83);
      return response(opcode, 0, Bytes{context_}) +
             (params[1] == 1 ? event(0xc6, {context_, 1, 0, 16}) : ecdh_request());
    case 0x67:
      if (joining_ == nullptr) return response(opcode, 0x83);
      if (!std::ranges::equal(params.subspan(1), joining_->static_oob))
        return response(opcode, 0) + event(0xc9, {context_, 4}) + event(0xc2, {context_, 2});
      return response(opcode, 0, Bytes{context_}) + ecdh_request();
    case 0x68:
      if (joining_ == nullptr) return response(opcode, 0x83);
      return response(opcode, 0, Bytes{context_}) + complete(params.subspan(1));
    case 0x69: board_public_.assign(params.begin() + 32, params.end()); return response(opcode, 0);
    case 0x6a: return response(opcode, 0);
    case 0x9b: return response(opcode, 0, number(first_handle));
    case 0x9c: return add_device_key(params);
    case 0x9d: {
      const std::uint16_t handle = ByteReader(params).read_u16_le();
      return response(opcode, device_keys.erase(handle) == 1 ? 0 : 0x8e, number(handle));
    }
    case 0x9e: return response(opcode, 0, number(static_cast<std::uint16_t>(max_device_keys)));
    default: return std::nullopt;
  }
}

Bytes FakeDevices::provision(ByteView params) {
  if (is_scanning || busy_contexts.contains(params[0])) return response(0x63, 0x83);
  context_ = params[0];
  const Bytes uuid(params.begin() + 1, params.begin() + 17);
  joining_net_key_.assign(params.begin() + 17, params.begin() + 33);
  last_iv_index = ByteReader(params.subspan(35)).read_u32_le();
  joining_address_ = ByteReader(params.subspan(39)).read_u16_le();
  ++context_count;
  const auto found = std::ranges::find_if(devices, [&](const FakeDevice& device) {
    return device.uuid == uuid && device.address == 0;
  });
  joining_ = found == devices.end() ? nullptr : &*found;
  const Bytes accepted = response(0x63, 0, Bytes{context_});
  if (joining_ == nullptr) return accepted;
  return accepted + event(0xc1, {context_}) + capabilities();
}

Bytes FakeDevices::event(std::uint8_t opcode, Bytes params) {
  if (closes_at == opcode) {
    closes_at.reset();
    joining_ = nullptr;
    return frame(0xc2, Bytes{context_, 2});
  }
  if (fails_at && fails_at->first == opcode) {
    const std::uint8_t code = std::exchange(fails_at, std::nullopt)->second;
    joining_ = nullptr;
    return frame(0xc9, Bytes{context_, code}) + frame(0xc2, Bytes{context_, 2});
  }
  if (lost_events.erase(opcode) == 1) return {};
  return frame(opcode, params);
}

Bytes FakeDevices::capabilities() {
  if (joining_ == nullptr) return {};
  const std::uint8_t oob = joining_->static_oob.empty() ? 0 : 1;
  return event(0xc3, Bytes{context_, joining_->elements, 0, oob} + Bytes(6, 0));
}

Bytes FakeDevices::ecdh_request() {
  return event(0xc7, Bytes{context_} + device_pair().public_key + Bytes(32, 0));
}

Bytes FakeDevices::complete(ByteView secret) {
  PublicKey board{};
  std::copy_n(board_public_.begin(), std::min(board.size(), board_public_.size()), board.begin());
  const auto expected = shared_secret(device_pair(), board);
  if (!expected || !std::ranges::equal(*expected, secret))
    return event(0xc9, {context_, 4}) + event(0xc2, {context_, 2});
  FakeDevice& device = *joining_;
  const Bytes done = Bytes{context_} + Bytes(6, 0) + number(joining_address_) + Bytes(2, 0);
  device.device_key = Bytes(16, static_cast<std::uint8_t>(device.uuid.back() + context_count));
  const Bytes first = event(0xc5, done + device.device_key + joining_net_key_);
  if (joining_ == nullptr) return first;  // it failed instead
  device.address = joining_address_;
  device.app_key.clear();
  device.net_key = joining_net_key_;
  device.refresh_phase = 0;
  if (!device.keeps_subscriptions) device.subscriptions.clear();
  joining_ = nullptr;
  return first + event(0xc2, {context_, 0});
}

Bytes FakeDevices::add_device_key(ByteView params) {
  ByteReader reader(params);
  const std::uint16_t owner = reader.read_u16_le();
  reader.read_u16_le();  // the subnet
  const ByteView rest = reader.read_rest();
  for (const auto& [handle, entry] : device_keys)
    if (entry.first == owner)
      return response(0x9c, std::ranges::equal(entry.second, rest) ? 0x81 : 0x8e);
  if (device_keys.size() >= max_device_keys) return response(0x9c, 0x8e);
  std::uint16_t handle = first_handle;
  while (device_keys.contains(handle)) ++handle;
  device_keys[handle] = {owner, Bytes(rest.begin(), rest.end())};
  most_device_keys = std::max(most_device_keys, device_keys.size());
  return response(0x9c, 0, number(handle));
}

Bytes FakeDevices::on_access(std::uint16_t devkey_handle, std::uint16_t destination,
                             ByteView payload) {
  const auto key = device_keys.find(devkey_handle);
  FakeDevice* device = at(destination);
  if (key == device_keys.end() || device == nullptr) return {};
  if (key->second.second != device->device_key || device->has_stopped) return {};
  if (!net_keys.empty() && !device->hears(net_keys.front())) return {};
  const std::string request = to_hex(payload);
  for (const std::string& deaf : device->deaf_to)
    if (request.starts_with(deaf)) return {};
  const auto is_lost = [&request](std::multiset<std::string>& losses) {
    const auto loss = std::ranges::find_if(
        losses, [&](const std::string& start) { return request.starts_with(start); });
    if (loss == losses.end()) return false;
    losses.erase(loss);
    return true;
  };
  if (is_lost(device->lost_requests)) return {};
  const Bytes reply = answer(*device, request);
  if (device->has_stopped || is_lost(device->lost_answers)) return {};
  const bool is_heard = net_keys.empty() || device->net_key.empty() ||
                        std::ranges::find(net_keys, device->sending_key()) != net_keys.end();
  return is_heard ? reply : Bytes{};
}

Bytes FakeDevices::answer(FakeDevice& device, const std::string& request) {
  std::uint8_t status = 0;
  for (const auto& [start, refusal] : device.refuses)
    if (request.starts_with(start)) status = refusal;
  for (const auto& [start, lie] : device.lies)
    if (request.starts_with(start)) return hex(lie);
  const Bytes params = hex(request);
  const auto from = [&](std::ptrdiff_t first, std::ptrdiff_t end) {
    return Bytes(params.begin() + first, params.begin() + end);
  };
  const auto end = static_cast<std::ptrdiff_t>(params.size());
  if (status == 0) device.requests.push_back(request);
  if (request == "800800") return hex("02") + device.composition;
  if (request.starts_with("00")) {
    if (status == 0) device.app_key = from(4, end);
    return hex("80 03") + Bytes{status} + from(1, 4);
  }
  const bool is_about_refresh = request.starts_with("8045") || request.starts_with("8016") ||
                                (request.starts_with("01") && params.size() == 20);
  if (is_about_refresh) return answer_refresh(device, status, params);
  if (request.starts_with("803d")) return hex("80 3e") + Bytes{status} + from(2, end);
  if (request.starts_with("03")) return answer_publication(device, status, from(1, end));
  if (request.starts_with("801b") || request.starts_with("801c"))
    return answer_subscription(device, status, params);
  if (request.starts_with("8029") || request.starts_with("802b"))
    return answer_list(device, status, params);
  if (const auto state = answer_state(device, request)) return *state;
  if (const auto heartbeats = answer_heartbeats(device, params)) return *heartbeats;
  if (request.starts_with("8018"))
    return hex("80 19") + Bytes{status} + from(2, 4) + hex("01 00 00 00 04 a7 00") + from(4, end);
  device.has_stopped = request.starts_with("801d") || request.starts_with("801e");
  if (request == "8049") {
    device.address = 0;
    device.subscriptions.clear();
    return hex("80 4a");
  }
  return {};
}

/// Answers Heartbeat Publication and Subscription. All heartbeats arrive at once.
std::optional<Bytes> FakeDevices::answer_heartbeats(FakeDevice& device, const Bytes& request) {
  FakeDevice::Heartbeats& own = device.heartbeats;
  ByteReader params(ByteView(request).subspan(std::min<std::size_t>(2, request.size())));
  if (request[0] != 0x80) return std::nullopt;
  if (request[1] == 0x39) {
    own.publishes_to = params.read_u16_le();
    const unsigned count = 1U << params.read_u8() >> 1U;
    for (FakeDevice& other : devices) {
      FakeDevice::Heartbeats& counter = other.heartbeats;
      if (counter.source != device.address || counter.destination != own.publishes_to) continue;
      const auto known = hearing.find({device.address, other.address});
      const Hearing heard = known == hearing.end() ? Hearing{count, 1, 1} : known->second;
      counter.count += heard.count;
      counter.min_hops = std::min(counter.min_hops, heard.min_hops);
      counter.max_hops = std::max(counter.max_hops, heard.max_hops);
    }
    return hex("06 00") + Bytes(request.begin() + 2, request.end());
  }
  if (request[1] != 0x3a && request[1] != 0x3b) return std::nullopt;
  if (request[1] == 0x3b) own = {own.publishes_to, params.read_u16_le(), params.read_u16_le()};
  std::uint8_t count_log = 0;
  while (own.count >> count_log != 0) ++count_log;
  return hex("80 3c 00") + number(own.source) + number(own.destination) +
         Bytes{5, count_log, own.min_hops, own.max_hops};
}

/// Answers Get and valid Set messages for default TTL, relay and network transmit.
std::optional<Bytes> FakeDevices::answer_state(FakeDevice& device, const std::string& request) {
  struct State {
    const char* get;
    const char* set;
    const char* status;
    Bytes& value;
  };
  const State states[] = {{"800c", "800d", "800e", device.default_ttl},
                          {"8026", "8027", "8028", device.relay},
                          {"8023", "8024", "8025", device.network_transmit}};
  for (const State& state : states) {
    const bool is_set = request.starts_with(state.set);
    if (request != state.get && !is_set) continue;
    const Bytes value = hex(request.substr(4));
    const bool is_fixed = &state.value == &device.relay && device.relay[0] == 2;
    if (is_set && !is_fixed) state.value = value;
    return hex(state.status) + state.value;
  }
  return std::nullopt;
}

/// Answers NetKey Update, AppKey Update and Key Refresh Phase Set.
Bytes FakeDevices::answer_refresh(FakeDevice& device, std::uint8_t status, const Bytes& request) {
  constexpr std::uint8_t cannot_update = 0x0b;
  const Bytes key(request.end() - std::min<std::ptrdiff_t>(16, std::ssize(request)), request.end());
  if (request[0] == 0x01) {
    const bool may_update = device.refresh_phase == 1;
    if (status == 0 && may_update) device.new_app_key = key;
    return hex("80 03") + Bytes{may_update ? status : cannot_update, 0, 0, 0};
  }
  if (request[1] == 0x45) {
    const bool is_same = device.refresh_phase == 1 && device.new_net_key == key;
    const bool may_update = device.refresh_phase == 0 || is_same;
    if (status == 0 && may_update) device.refresh_phase = 1;
    if (status == 0 && may_update) device.new_net_key = key;
    return hex("80 44") + Bytes{may_update ? status : cannot_update, 0, 0};
  }
  const bool is_to_finish = request[4] == 3;
  if (!is_to_finish && device.refresh_phase == 0) return {};  // as Nordic's robot
  if (status == 0 && is_to_finish && device.refresh_phase > 0) {
    device.net_key = device.new_net_key;
    device.app_key = device.new_app_key;
  }
  if (status == 0) device.refresh_phase = is_to_finish ? 0 : 2;
  return hex("80 17") + Bytes{status, 0, 0, static_cast<std::uint8_t>(device.refresh_phase)};
}

/// Answers Publication Set. Nordic leaves the period undefined for models without a periodic one.
Bytes FakeDevices::answer_publication(FakeDevice& device, std::uint8_t status, Bytes params) {
  constexpr std::size_t ttl_at = 6;
  constexpr std::size_t period_at = 7;
  device.has_stopped = params[ttl_at] > 127 && params[ttl_at] < 255;
  if (device.has_stopped) return {};
  const bool is_health_server = params.size() == 11 && params[9] == 0x02;
  if (!is_health_server) params[period_at] = 0xa7;
  return hex("80 19") + Bytes{status} + params;
}

/// Answers Model Subscription Add and Delete.
Bytes FakeDevices::answer_subscription(FakeDevice& device, std::uint8_t status, ByteView request) {
  ByteReader params(request.subspan(2));
  const std::uint16_t element = params.read_u16_le();
  const std::uint16_t group = params.read_u16_le();
  const ByteView model = params.read_rest();
  const std::string list = device.shares_subscriptions ? "" : to_hex(number(element) + model);
  if (status == 0 && request[1] == 0x1b) device.subscriptions[list].insert(group);
  if (status == 0 && request[1] == 0x1c) device.subscriptions[list].erase(group);
  return hex("80 1f") + Bytes{status} + number(element) + number(group) + model;
}

/// Answers SIG and Vendor Model Subscription Get.
Bytes FakeDevices::answer_list(const FakeDevice& device, std::uint8_t status, ByteView request) {
  const ByteView model = request.subspan(2);  // element and model, as they come
  Bytes answer{0x80, static_cast<std::uint8_t>(request[1] + 1), status};
  answer = answer + model;
  const auto list = device.subscriptions.find(device.shares_subscriptions ? "" : to_hex(model));
  if (status != 0 || list == device.subscriptions.end()) return answer;
  for (const std::uint16_t group : list->second) answer = answer + number(group);
  return answer;
}

Bytes FakeDevices::beacons() const {
  Bytes all;
  if (!is_scanning) return all;
  for (const FakeDevice& device : devices)
    if (device.address == 0)
      all = all + frame(0xc0, device.uuid + hex("c8 00 01 c4 3b f9 0b 6e 01"));
  return all;
}

void FakeDevices::on_restart() {
  is_scanning = false;
  joining_ = nullptr;
}

}  // namespace slamgw::ble
