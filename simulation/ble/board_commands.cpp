// SPDX-License-Identifier: Apache-2.0
// The board's commands, first half: the table of all, the device, keys, provisioning. Sizes and
// status codes as in Nordic's serial_cmd documentation and handlers (SDK for Mesh 3.1.0).
#include <algorithm>

#include "simulation/ble/board.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t serial_version_number = 10;
constexpr std::uint16_t max_key_index = 0x0fff;
constexpr std::chrono::seconds link_time{60};

Key key_at(ByteView params, std::size_t offset) {
  Key key{};
  std::copy_n(params.begin() + static_cast<std::ptrdiff_t>(offset), key.size(), key.begin());
  return key;
}

Bytes u16(std::uint16_t value) {
  Bytes out;
  put_u16_le(out, value);
  return out;
}

}  // namespace

const Board::Command* Board::find_command(std::uint8_t opcode) {
  static constexpr Command command_table[] = {
      {0x09, 0, 0, &Board::serial_version},
      {0x14, 0, 0, &Board::housekeeping_get},
      {0x15, 0, 0, &Board::housekeeping_clear},
      {0x20, 0, 254, &Board::refuse_application},
      {0x53, 16, 16, &Board::uuid_set},
      {0x54, 0, 0, &Board::uuid_get},
      {0x90, 0, 0, &Board::enable},
      {0x91, 0, 0, &Board::disable},
      {0x92, 18, 18, &Board::subnet_add},
      {0x93, 18, 18, &Board::subnet_update},
      {0x94, 2, 2, &Board::subnet_delete},
      {0x95, 0, 0, &Board::subnet_get_all},
      {0x96, 0, 0, &Board::subnet_count_max},
      {0x97, 20, 20, &Board::appkey_add},
      {0x98, 18, 18, &Board::appkey_update},
      {0x99, 2, 2, &Board::appkey_delete},
      {0x9a, 2, 2, &Board::appkey_get_all},
      {0x9b, 0, 0, &Board::appkey_count_max},
      {0x9c, 20, 20, &Board::devkey_add},
      {0x9d, 2, 2, &Board::devkey_delete},
      {0x9e, 0, 0, &Board::devkey_count_max},
      {0x9f, 4, 4, &Board::local_unicast_set},
      {0xa0, 0, 0, &Board::local_unicast_get},
      {0xa1, 2, 2, &Board::subscription_add},
      {0xa3, 2, 2, &Board::subscription_remove},
      {0xa4, 2, 2, &Board::publication_add},
      {0xa6, 2, 2, &Board::publication_remove},
      {0xa7, 2, 2, &Board::address_get},
      {0xa8, 0, 0, &Board::address_get_all},
      {0xa9, 0, 0, &Board::nonvirtual_count_max},
      {0xaa, 0, 0, &Board::virtual_count_max},
      {0xab, 10, 254, &Board::packet_send},
      {0xac, 0, 0, &Board::state_clear},
  };
  const auto* found = std::find_if(std::begin(command_table), std::end(command_table),
                                   [&](const Command& c) { return c.opcode == opcode; });
  return found == std::end(command_table) ? nullptr : found;
}

/// No length checks here, and unknown opcodes of this range get no reply at all. No device waits to
/// be provisioned, so every link runs into its time-out.
void Board::on_provisioning(std::uint8_t opcode, ByteView params, TimePoint now) {
  const std::uint8_t context = params.empty() ? std::uint8_t{0} : params[0];
  switch (opcode) {
    case 0x61:  // Scan Start
      respond(opcode, {is_scanning_ ? Status::invalid_state : Status::success, {}});
      is_scanning_ = true;
      return;
    case 0x62:  // Scan Stop
      is_scanning_ = false;
      return respond(opcode, {});
    case 0x63:  // Provision
      if (context > 1) return respond(opcode, {Status::invalid_data, {}});
      if (link_timeouts_.contains(context)) return respond(opcode, {Status::invalid_state, {}});
      link_timeouts_[context] = now + link_time;
      return respond(opcode, {Status::success, {context}});
    case 0x64:  // Listen
    case 0x69:  // Keypair Set
    case 0x6a:  // Capabilities Set
      return respond(opcode, {});
    case 0x66:  // OOB Use
    case 0x67:  // Auth Data
    case 0x68:  // ECDH Secret
      return respond(opcode, {context > 1 ? Status::invalid_data : Status::invalid_state, {}});
    default: return;
  }
}

Board::Reply Board::serial_version(ByteView, TimePoint) {
  return {Status::success, u16(serial_version_number)};
}

Board::Reply Board::housekeeping_get(ByteView, TimePoint) {
  Bytes data;
  put_u32_le(data, dropped_);
  return {Status::success, data};
}

Board::Reply Board::housekeeping_clear(ByteView, TimePoint) {
  dropped_ = 0;
  return {};
}

/// The stock example registers no application callback.
Board::Reply Board::refuse_application(ByteView, TimePoint) { return {Status::rejected, {}}; }

Board::Reply Board::uuid_set(ByteView params, TimePoint) {
  uuid_ = key_at(params, 0);
  return {};
}

Board::Reply Board::uuid_get(ByteView, TimePoint) {
  return {Status::success, Bytes(uuid_.begin(), uuid_.end())};
}

Board::Reply Board::enable(ByteView, TimePoint) {
  if (is_enabled_) return {Status::invalid_state, {}};
  is_enabled_ = true;
  return {};
}

Board::Reply Board::disable(ByteView, TimePoint) {
  if (!is_enabled_) return {Status::invalid_state, {}};
  is_enabled_ = false;
  return {};
}

Board::Reply Board::subnet_add(ByteView params, TimePoint) {
  const std::uint16_t index = get_u16_le(params, 0);
  if (index > max_key_index) return {Status::invalid_parameter, {}};
  const Added added = subnets_.add(index, 0, key_at(params, 2));
  return {added.status, u16(added.handle)};
}

Board::Reply Board::subnet_update(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  KeyTable::Slot* subnet = subnets_.find(handle);
  if (subnet == nullptr) return {Status::rejected, {}};
  subnet->key = key_at(params, 2);
  return {Status::success, u16(handle)};
}

Board::Reply Board::subnet_delete(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  if (!subnets_.remove(handle)) return {Status::rejected, {}};
  appkeys_.remove_of_subnet(handle);
  devkeys_.remove_of_subnet(handle);
  return {Status::success, u16(handle)};
}

Board::Reply Board::subnet_get_all(ByteView, TimePoint) {
  Bytes data;
  for (const std::uint16_t index : subnets_.indexes()) put_u16_le(data, index);
  return {Status::success, data};
}

Board::Reply Board::subnet_count_max(ByteView, TimePoint) {
  return {Status::success, u16(subnets_.capacity())};
}

Board::Reply Board::appkey_add(ByteView params, TimePoint) {
  const std::uint16_t index = get_u16_le(params, 0);
  const Handle subnet = get_u16_le(params, 2);
  if (index > max_key_index) return {Status::invalid_parameter, {}};
  if (subnets_.find(subnet) == nullptr) return {Status::rejected, {}};
  const Added added = appkeys_.add(index, subnet, key_at(params, 4));
  return {added.status, u16(added.handle)};
}

Board::Reply Board::appkey_update(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  KeyTable::Slot* appkey = appkeys_.find(handle);
  if (appkey == nullptr) return {Status::rejected, {}};
  appkey->key = key_at(params, 2);
  return {Status::success, u16(handle)};
}

Board::Reply Board::appkey_delete(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  if (!appkeys_.remove(handle)) return {Status::rejected, {}};
  return {Status::success, u16(handle)};
}

Board::Reply Board::appkey_get_all(ByteView params, TimePoint) {
  const Handle subnet = get_u16_le(params, 0);
  if (subnets_.find(subnet) == nullptr) return {Status::rejected, {}};
  Bytes data = u16(subnet);
  for (const std::uint16_t index : appkeys_.indexes_of_subnet(subnet)) put_u16_le(data, index);
  return {Status::success, data};
}

Board::Reply Board::appkey_count_max(ByteView, TimePoint) {
  return {Status::success, u16(appkeys_.capacity())};
}

Board::Reply Board::devkey_add(ByteView params, TimePoint) {
  const Address owner = get_u16_le(params, 0);
  const Handle subnet = get_u16_le(params, 2);
  if (!is_unicast(owner)) return {Status::invalid_parameter, {}};
  if (subnets_.find(subnet) == nullptr) return {Status::rejected, {}};
  const Added added = devkeys_.add(owner, subnet, key_at(params, 4));
  return {added.status, u16(added.handle)};
}

Board::Reply Board::devkey_delete(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  if (!devkeys_.remove(handle)) return {Status::rejected, {}};
  return {Status::success, u16(handle)};
}

Board::Reply Board::devkey_count_max(ByteView, TimePoint) {
  return {Status::success, u16(devkeys_.capacity())};
}

}  // namespace slamgw::sim::ble
