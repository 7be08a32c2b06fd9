// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/address_commands.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

enum class AddressType : std::uint8_t { unicast = 1, virtual_label = 2, group = 3 };

AddressType type_of(const AddressTable::Slot& slot) {
  if (slot.label) return AddressType::virtual_label;
  return is_unicast(slot.address) ? AddressType::unicast : AddressType::group;
}

Key label_of(ByteView params) {
  Key label{};
  std::copy_n(params.begin(), label.size(), label.begin());
  return label;
}

Reply reply_of(Status status, Handle handle) {
  return status == Status::success ? reply_with(handle) : Reply{status};
}

}  // namespace

std::optional<Reply> AddressCommands::on_command(std::uint8_t opcode, ByteView params) {
  using Self = AddressCommands;
  static constexpr Command<Self> commands[] = {
      {0x9f, 4, 4, &Self::local_unicast_set},
      {0xa0, 0, 0, &Self::local_unicast_get},
      {0xa1, 2, 2, &Self::subscription_add},
      {0xa2, 16, 16, &Self::subscription_add_virtual},
      {0xa3, 2, 2, &Self::subscription_remove},
      {0xa4, 2, 2, &Self::publication_add},
      {0xa5, 16, 16, &Self::publication_add_virtual},
      {0xa6, 2, 2, &Self::publication_remove},
      {0xa7, 2, 2, &Self::address_get},
      {0xa8, 0, 0, &Self::address_get_all},
      {0xa9, 0, 0, &Self::nonvirtual_count_max},
      {0xaa, 0, 0, &Self::virtual_count_max},
  };
  return run_command(commands, *this, opcode, params);
}

/// Sets the address once; only State Clear undoes it. Accepts more elements than the firmware has.
Reply AddressCommands::local_unicast_set(ByteView params) {
  const std::uint32_t start = get_u16_le(params, 0);
  const std::uint32_t count = get_u16_le(params, 2);
  if (flash_.local_count != 0) return {Status::rejected};
  if (start == 0 || count == 0 || start + count - 1 > 0x7fff) return {Status::invalid_data};
  flash_.local_start = static_cast<Address>(start);
  flash_.local_count = static_cast<std::uint16_t>(count);
  return {};
}

Reply AddressCommands::local_unicast_get(ByteView) {
  Reply reply = reply_with(flash_.local_start);
  put_u16_le(reply.data, flash_.local_count);
  return reply;
}

Reply AddressCommands::subscription_add(ByteView params) {
  const Address address = get_u16_le(params, 0);
  if (!is_group(address)) return {Status::invalid_data};
  return reply_of(flash_.addresses.add_subscription(address));
}

Reply AddressCommands::subscription_add_virtual(ByteView params) {
  return reply_of(flash_.addresses.add_virtual_subscription(label_of(params)));
}

Reply AddressCommands::subscription_remove(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  return reply_of(flash_.addresses.remove_subscription(handle), handle);
}

Reply AddressCommands::publication_add(ByteView params) {
  const Address address = get_u16_le(params, 0);
  if (!is_group(address) && !is_unicast(address)) return {Status::invalid_data};
  return reply_of(flash_.addresses.add_publication(address));
}

Reply AddressCommands::publication_add_virtual(ByteView params) {
  return reply_of(flash_.addresses.add_virtual_publication(label_of(params)));
}

Reply AddressCommands::publication_remove(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  return reply_of(flash_.addresses.remove_publication(handle), handle);
}

/// Returns handle, type, subscription flag, the address, and the label of a virtual one.
Reply AddressCommands::address_get(ByteView params) {
  const Handle handle = get_u16_le(params, 0);
  const AddressTable::Slot* slot = flash_.addresses.find(handle);
  if (slot == nullptr) return {Status::rejected};
  Reply reply = reply_with(handle);
  put_u8(reply.data, static_cast<std::uint8_t>(type_of(*slot)));
  put_u8(reply.data, is_heard(*slot) ? 1 : 0);
  put_u16_le(reply.data, slot->address);
  if (slot->label) put(reply.data, *slot->label);
  return reply;
}

/// The board is not a proxy, so it does not receive messages to the group of all proxies.
bool AddressCommands::is_heard(const AddressTable::Slot& slot) const {
  if (is_unicast(slot.address)) return flash_.is_local(slot.address);
  return slot.subscriptions > 0 && slot.address != all_proxies;
}

Reply AddressCommands::address_get_all(ByteView) {
  Reply reply;
  for (const Handle handle : flash_.addresses.handles()) put_u16_le(reply.data, handle);
  return reply;
}

Reply AddressCommands::nonvirtual_count_max(ByteView) {
  return reply_with(AddressTable::max_nonvirtual);
}

Reply AddressCommands::virtual_count_max(ByteView) { return reply_with(AddressTable::max_virtual); }

}  // namespace slamgw::sim::ble
