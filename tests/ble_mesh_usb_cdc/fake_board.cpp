// SPDX-License-Identifier: Apache-2.0
#include "tests/ble_mesh_usb_cdc/fake_board.hpp"

#include <algorithm>

#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/serial_frame.hpp"

namespace slamgw::ble {
namespace {

Bytes indexes(const std::vector<std::pair<std::uint16_t, Bytes>>& keys) {
  ByteWriter writer;
  for (const auto& [index, key] : keys) writer.write_u16_le(index);
  return writer.take();
}

}  // namespace

Bytes FakeBoard::on_bytes(ByteView bytes) {
  Bytes answer;
  for (const std::uint8_t byte : bytes) {
    if (partial_.empty() && byte == 0) {
      answer = answer + response(0, 0x84);
      continue;
    }
    partial_.push_back(byte);
    if (partial_.size() < std::size_t{partial_[0]} + 1) continue;
    const Bytes packet = std::exchange(partial_, {});
    const std::size_t number_of_this = commands.size();
    commands.push_back(packet[1]);
    const bool is_lost = ignored.contains(packet[1]) || ignore_command_number == number_of_this;
    const Bytes reply = execute(packet[1], ByteView(packet).subspan(2));
    if (!is_lost) answer = answer + reply;
  }
  return is_silent ? Bytes{} : answer;
}

Bytes FakeBoard::execute(std::uint8_t opcode, ByteView params) {
  const auto forced = status_of.find(opcode);
  if (forced != status_of.end()) return response(opcode, forced->second);
  ByteReader reader(params);
  switch (opcode) {
    case 0x02: return frame(0x82, params);
    case 0x09: return response(opcode, 0, number(serial_version));
    case 0x14: return response(opcode, 0, ByteWriter{}.write_u32_le(dropped).bytes());
    case 0x54: return response(opcode, 0, Bytes(16, uuid_octet));
    case 0x90: return response(opcode, std::exchange(is_enabled, true) ? 0x83 : 0x00);
    case 0x92: {
      const std::uint16_t index = reader.read_u16_le();
      return add_key(subnets, opcode, index, reader.read_rest());
    }
    case 0x93: return update_key(opcode, reader, subnets.size(), new_net_key);
    case 0x98:
      if (new_net_key.empty()) return response(opcode, 0x83);
      return update_key(opcode, reader, appkeys.size(), new_app_key);
    case 0x95: return response(opcode, 0, indexes(subnets));
    case 0x97: {
      const std::uint16_t index = reader.read_u16_le();
      if (reader.read_u16_le() >= subnets.size()) return response(opcode, 0x8e);
      return add_key(appkeys, opcode, index, reader.read_rest());
    }
    case 0x9a: return list_appkeys(reader.read_u16_le());
    case 0x9f:
      if (unicast != 0) return response(opcode, 0x8e);
      unicast = reader.read_u16_le();
      unicast_count = reader.read_u16_le();
      return response(opcode, 0);
    case 0xa0:
      return response(opcode, 0, number(unicast) + number(unicast == 0 ? 0 : unicast_count));
    case 0xa1:
    case 0xa4: return add_address(opcode, reader.read_u16_le());
    case 0xa6: return remove_address(opcode, reader.read_u16_le());
    case 0xa7: return get_address(reader.read_u16_le());
    case 0xa8: {
      Bytes handles;
      for (std::size_t i = 0; i < addresses.size(); ++i)
        if (addresses[i]) handles = handles + number(static_cast<std::uint16_t>(i));
      return response(opcode, 0, handles);
    }
    case 0x0e: return restart();
    case 0xab: return send_packet(reader);
    case 0xac: return clear();
    default: return devices.execute(opcode, params).value_or(response(opcode, 0x82));
  }
}

Bytes FakeBoard::add_key(std::vector<std::pair<std::uint16_t, Bytes>>& keys, std::uint8_t opcode,
                         std::uint16_t index, ByteView key) {
  for (const auto& [known_index, known] : keys)
    if (known_index == index) return response(opcode, std::ranges::equal(known, key) ? 0x81 : 0x8e);
  keys.emplace_back(index, Bytes(key.begin(), key.end()));
  return response(opcode, 0, number(static_cast<std::uint16_t>(keys.size() - 1)));
}

Bytes FakeBoard::update_key(std::uint8_t opcode, ByteReader params, std::size_t keys,
                            Bytes& new_key) const {
  const std::uint16_t handle = params.read_u16_le();
  const ByteView key = params.read_rest();
  if (handle >= keys) return response(opcode, 0x8e);
  if (!new_key.empty() && !std::ranges::equal(new_key, key)) return response(opcode, 0x83);
  new_key.assign(key.begin(), key.end());
  return response(opcode, 0, number(handle));
}

Bytes FakeBoard::list_appkeys(std::uint16_t subnet) const {
  if (subnet >= subnets.size()) return response(0x9a, 0x8e);
  // As recorded from all releases: success without any data, not even the handle.
  if (appkeys.empty()) return response(0x9a, 0);
  return response(0x9a, 0, number(subnet) + indexes(appkeys));
}

Bytes FakeBoard::add_address(std::uint8_t opcode, std::uint16_t address) {
  auto handle = handle_of(address);
  if (!handle) {
    const auto used = std::ranges::count_if(addresses, [](const auto& a) { return a.has_value(); });
    if (static_cast<std::size_t>(used) >= max_addresses) return response(opcode, 0x8e);
    const auto free = std::ranges::find_if(addresses, [](const auto& a) { return !a; });
    handle = static_cast<std::uint16_t>(free - addresses.begin());
    if (*handle == addresses.size()) addresses.emplace_back();
    addresses[*handle] = Address{address};
  }
  Address& entry = *addresses[*handle];
  if (opcode == 0xa1) entry.is_subscribed = true;
  if (opcode == 0xa4) ++entry.published;
  return response(opcode, 0, number(*handle));
}

Bytes FakeBoard::remove_address(std::uint8_t opcode, std::uint16_t handle) {
  if (handle >= addresses.size() || !addresses[handle]) return response(opcode, 0x8e);
  if (--addresses[handle]->published <= 0 && !addresses[handle]->is_subscribed)
    addresses[handle].reset();
  return response(opcode, 0, number(handle));
}

Bytes FakeBoard::get_address(std::uint16_t handle) const {
  if (handle >= addresses.size() || !addresses[handle]) return response(0xa7, 0x8e);
  const Address& entry = *addresses[handle];
  return response(0xa7, 0,
                  ByteWriter{}
                      .write_u16_le(handle)
                      .write_u8(entry.address < 0x8000 ? 1 : 3)
                      .write_u8(entry.is_subscribed ? 1 : 0)
                      .write_u16_le(entry.address)
                      .bytes());
}

Bytes FakeBoard::send_packet(ByteReader params) {
  SentPacket packet;
  packet.appkey_handle = params.read_u16_le();
  packet.source = params.read_u16_le();
  const std::uint16_t handle = params.read_u16_le();
  packet.ttl = params.read_u8();
  params.read(serial_version >= 9 ? 3 : serial_version >= 6 ? 2 : 1);
  const ByteView payload = params.read_rest();
  if (!params.ok()) return response(0xab, 0x84);
  if (handle >= addresses.size() || !addresses[handle]) return response(0xab, 0x8e);
  const bool is_own =
      unicast != 0 && packet.source >= unicast && packet.source < unicast + unicast_count;
  if (!is_own) return response(0xab, 0x87);
  const bool has_key =
      packet.appkey_handle < appkeys.size() || devices.device_keys.contains(packet.appkey_handle);
  if (!has_key) return response(0xab, 0x8e);
  if (busy_sends > 0 && busy_sends-- > 0) return response(0xab, 0x83);
  packet.destination = addresses[handle]->address;
  packet.payload.assign(payload.begin(), payload.end());
  sent.push_back(packet);
  ++token_;
  const Bytes token = ByteWriter{}.write_u32_le(token_).take();
  devices.net_keys.clear();
  if (!subnets.empty()) devices.net_keys.push_back(subnets.front().second);
  if (!new_net_key.empty()) devices.net_keys.push_back(new_net_key);
  const Bytes reply = devices.on_access(packet.appkey_handle, packet.destination, packet.payload);
  const Bytes heard =
      reply.empty() ? Bytes{} : message(packet.destination, reply, 0, packet.appkey_handle);
  if (serial_version < 10) return response(0xab, 0) + heard;
  return response(0xab, 0, token) + frame(0xd2, token) + heard;
}

Bytes FakeBoard::clear() {
  unicast = 0;
  subnets.clear();
  appkeys.clear();
  new_net_key.clear();
  new_app_key.clear();
  addresses.clear();
  devices.device_keys.clear();
  return response(0xac, 0);
}

Bytes FakeBoard::restart() {
  partial_.clear();
  if (forgets) clear();
  devices.on_restart();
  return hex("04 81 02 00 fe");
}

Bytes FakeBoard::message(std::uint16_t source, ByteView payload, std::uint16_t group,
                         std::uint16_t key_handle) const {
  return frame(group == 0 ? 0xd0 : 0xd1,
               ByteWriter{}
                   .write_u16_le(source)
                   .write_u16_le(group == 0 ? unicast : handle_of(group).value_or(0))
                   .write_u16_le(key_handle)
                   .write_u16_le(0)
                   .write_u8(4)
                   .write(hex("01 c4 3b f9 0b 6e 01 c9"))
                   .write_u16_le(static_cast<std::uint16_t>(payload.size()))
                   .write(payload)
                   .bytes());
}

std::optional<std::uint16_t> FakeBoard::handle_of(std::uint16_t address) const {
  for (std::size_t i = 0; i < addresses.size(); ++i)
    if (addresses[i] && addresses[i]->address == address) return static_cast<std::uint16_t>(i);
  return std::nullopt;
}

std::size_t FakeBoard::count(std::uint8_t opcode) const {
  return static_cast<std::size_t>(std::ranges::count(commands, opcode));
}

}  // namespace slamgw::ble
