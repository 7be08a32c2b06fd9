// SPDX-License-Identifier: Apache-2.0
// The board's commands, first half: the table of all, the device, keys. Sizes and
// status codes as in Nordic's serial_cmd documentation and handlers (SDK for Mesh 3.1.0).
#include <algorithm>

#include "simulation/ble/board/board.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t serial_version_number = 10;
constexpr std::uint16_t max_key_index = 0x0fff;

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

Reply Board::serial_version(ByteView, TimePoint) {
  return {Status::success, u16(serial_version_number)};
}

Reply Board::housekeeping_get(ByteView, TimePoint) {
  Bytes data;
  put_u32_le(data, dropped_);
  return {Status::success, data};
}

Reply Board::housekeeping_clear(ByteView, TimePoint) {
  dropped_ = 0;
  return {};
}

/// The stock example registers no application callback.
Reply Board::refuse_application(ByteView, TimePoint) { return {Status::rejected, {}}; }

Reply Board::uuid_set(ByteView params, TimePoint) {
  uuid_ = key_at(params, 0);
  return {};
}

Reply Board::uuid_get(ByteView, TimePoint) {
  return {Status::success, Bytes(uuid_.begin(), uuid_.end())};
}

Reply Board::enable(ByteView, TimePoint) {
  if (is_enabled_) return {Status::invalid_state, {}};
  is_enabled_ = true;
  return {};
}

Reply Board::disable(ByteView, TimePoint) {
  if (!is_enabled_) return {Status::invalid_state, {}};
  is_enabled_ = false;
  return {};
}

Reply Board::subnet_add(ByteView params, TimePoint) {
  const std::uint16_t index = get_u16_le(params, 0);
  if (index > max_key_index) return {Status::invalid_parameter, {}};
  const Added added = flash_.subnets.add(index, 0, key_at(params, 2));
  return {added.status, u16(added.handle)};
}

Reply Board::subnet_update(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  KeyTable::Slot* subnet = flash_.subnets.find(handle);
  if (subnet == nullptr) return {Status::rejected, {}};
  subnet->key = key_at(params, 2);
  return {Status::success, u16(handle)};
}

Reply Board::subnet_delete(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  if (!flash_.subnets.remove(handle)) return {Status::rejected, {}};
  flash_.appkeys.remove_of_subnet(handle);
  flash_.devkeys.remove_of_subnet(handle);
  return {Status::success, u16(handle)};
}

Reply Board::subnet_get_all(ByteView, TimePoint) {
  Bytes data;
  for (const std::uint16_t index : flash_.subnets.indexes()) put_u16_le(data, index);
  return {Status::success, data};
}

Reply Board::subnet_count_max(ByteView, TimePoint) {
  return {Status::success, u16(flash_.subnets.capacity())};
}

Reply Board::appkey_add(ByteView params, TimePoint) {
  const std::uint16_t index = get_u16_le(params, 0);
  const Handle subnet = get_u16_le(params, 2);
  if (index > max_key_index) return {Status::invalid_parameter, {}};
  if (flash_.subnets.find(subnet) == nullptr) return {Status::rejected, {}};
  const Added added = flash_.appkeys.add(index, subnet, key_at(params, 4));
  return {added.status, u16(added.handle)};
}

Reply Board::appkey_update(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  KeyTable::Slot* appkey = flash_.appkeys.find(handle);
  if (appkey == nullptr) return {Status::rejected, {}};
  appkey->key = key_at(params, 2);
  return {Status::success, u16(handle)};
}

Reply Board::appkey_delete(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  if (!flash_.appkeys.remove(handle)) return {Status::rejected, {}};
  return {Status::success, u16(handle)};
}

/// The network's handle and its keys' indexes; nothing at all, not even the handle, without keys.
Reply Board::appkey_get_all(ByteView params, TimePoint) {
  const Handle subnet = get_u16_le(params, 0);
  if (flash_.subnets.find(subnet) == nullptr) return {Status::rejected, {}};
  const std::vector<std::uint16_t> indexes = flash_.appkeys.indexes_of_subnet(subnet);
  if (indexes.empty()) return {};
  Bytes data = u16(subnet);
  for (const std::uint16_t index : indexes) put_u16_le(data, index);
  return {Status::success, data};
}

Reply Board::appkey_count_max(ByteView, TimePoint) {
  return {Status::success, u16(flash_.appkeys.capacity())};
}

/// Unlike the other two tables this one refuses a known owner with the same key as well.
Reply Board::devkey_add(ByteView params, TimePoint) {
  const Address owner = get_u16_le(params, 0);
  const Handle subnet = get_u16_le(params, 2);
  if (!is_unicast(owner)) return {Status::invalid_parameter, {}};
  if (flash_.subnets.find(subnet) == nullptr) return {Status::rejected, {}};
  const Added added = flash_.devkeys.add(owner, subnet, key_at(params, 4));
  if (added.status != Status::success) return {Status::rejected, {}};
  return {Status::success, u16(added.handle)};
}

Reply Board::devkey_delete(ByteView params, TimePoint) {
  const Handle handle = get_u16_le(params, 0);
  if (!flash_.devkeys.remove(handle)) return {Status::rejected, {}};
  return {Status::success, u16(handle)};
}

Reply Board::devkey_count_max(ByteView, TimePoint) {
  return {Status::success, u16(flash_.devkeys.capacity())};
}

}  // namespace slamgw::sim::ble
