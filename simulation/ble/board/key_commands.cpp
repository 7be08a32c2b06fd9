// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/key_commands.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t max_key_index = 0x0fff;

Key key_in(ByteView params, std::size_t offset) {
  Key key{};
  std::copy_n(params.begin() + static_cast<std::ptrdiff_t>(offset), key.size(), key.begin());
  return key;
}

}  // namespace

std::optional<Reply> KeyCommands::on_command(std::uint8_t opcode, ByteView params) {
  using Self = KeyCommands;
  static constexpr Command<Self> commands[] = {
      {0x92, 18, 18, &Self::subnet_add},     {0x93, 18, 18, &Self::subnet_update},
      {0x94, 2, 2, &Self::subnet_delete},    {0x95, 0, 0, &Self::subnet_get_all},
      {0x96, 0, 0, &Self::subnet_count_max}, {0x97, 20, 20, &Self::appkey_add},
      {0x98, 18, 18, &Self::appkey_update},  {0x99, 2, 2, &Self::appkey_delete},
      {0x9a, 2, 2, &Self::appkey_get_all},   {0x9b, 0, 0, &Self::appkey_count_max},
      {0x9c, 20, 20, &Self::devkey_add},     {0x9d, 2, 2, &Self::devkey_delete},
      {0x9e, 0, 0, &Self::devkey_count_max},
  };
  return run_command(commands, *this, opcode, params);
}

Reply KeyCommands::subnet_add(ByteView params) {
  const std::uint16_t index = get_u16_le(params, 0);
  if (index > max_key_index) return {Status::invalid_parameter};
  return reply_of(flash_.subnets.add(index, 0, key_in(params, 2)));
}

/// Begins a key refresh.
Reply KeyCommands::subnet_update(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  if (flash_.subnets.find(handle) == nullptr) return {Status::rejected};
  const Status status = flash_.subnets.update(handle, key_in(params, 2));
  return status == Status::success ? reply_with(handle) : Reply{status};
}

/// Deletes a network with its application keys, but not its device keys. The last network stays.
Reply KeyCommands::subnet_delete(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  if (flash_.subnets.find(handle) == nullptr || flash_.subnets.handles().size() == 1) {
    return {Status::rejected};
  }
  flash_.subnets.remove(handle);
  flash_.appkeys.remove_of_subnet(handle);
  return reply_with(handle);
}

Reply KeyCommands::subnet_get_all(ByteView) {
  Reply reply;
  for (const std::uint16_t index : flash_.subnets.indexes()) put_u16_le(reply.data, index);
  return reply;
}

Reply KeyCommands::subnet_count_max(ByteView) { return reply_with(flash_.subnets.capacity()); }

Reply KeyCommands::appkey_add(ByteView params) {
  const std::uint16_t index = get_u16_le(params, 0);
  const Handle subnet = get_u16_le(params, 2);
  if (flash_.subnets.find(subnet) == nullptr) return {Status::rejected};
  if (index > max_key_index) return {Status::invalid_parameter};
  return reply_of(flash_.appkeys.add(index, subnet, key_in(params, 4)));
}

/// Allowed only during a key refresh of its network.
Reply KeyCommands::appkey_update(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  const KeyTable::Slot* appkey = flash_.appkeys.find(handle);
  if (appkey == nullptr) return {Status::rejected};
  if (!flash_.subnets.find(appkey->subnet)->new_key) return {Status::invalid_state};
  const Status status = flash_.appkeys.update(handle, key_in(params, 2));
  return status == Status::success ? reply_with(handle) : Reply{status};
}

Reply KeyCommands::appkey_delete(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  return flash_.appkeys.remove(handle) ? reply_with(handle) : Reply{Status::rejected};
}

/// Returns the network's handle and its keys' indexes, or no data without keys.
Reply KeyCommands::appkey_get_all(ByteView params) {
  const Handle subnet = get_u16_le(params, 0);
  if (flash_.subnets.find(subnet) == nullptr) return {Status::rejected};
  const std::vector<std::uint16_t> indexes = flash_.appkeys.indexes_of_subnet(subnet);
  if (indexes.empty()) return {};
  Reply reply = reply_with(subnet);
  for (const std::uint16_t index : indexes) put_u16_le(reply.data, index);
  return reply;
}

Reply KeyCommands::appkey_count_max(ByteView) { return reply_with(flash_.appkeys.capacity()); }

/// Unlike the other two tables, this one also refuses a known owner with the same key.
Reply KeyCommands::devkey_add(ByteView params) {
  const Address owner = get_u16_le(params, 0);
  const Handle subnet = get_u16_le(params, 2);
  if (!is_unicast(owner)) return {Status::invalid_data};
  if (flash_.subnets.find(subnet) == nullptr) return {Status::rejected};
  const Added added = flash_.devkeys.add(owner, subnet, key_in(params, 4));
  return added.status == Status::success ? reply_with(added.handle) : Reply{Status::rejected};
}

Reply KeyCommands::devkey_delete(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  return flash_.devkeys.remove(handle) ? reply_with(handle) : Reply{Status::rejected};
}

Reply KeyCommands::devkey_count_max(ByteView) { return reply_with(flash_.devkeys.capacity()); }

}  // namespace slamgw::sim::ble
