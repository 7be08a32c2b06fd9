// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/address_table.hpp"

#include "simulation/ble/security.hpp"

namespace slamgw::sim::ble {

Added AddressTable::add_virtual_subscription(const Key& label) {
  return add({virtual_address(label), label}, &Slot::subscriptions);
}

Added AddressTable::add_virtual_publication(const Key& label) {
  return add({virtual_address(label), label}, &Slot::publications);
}

Added AddressTable::add(const Slot& slot, std::uint16_t Slot::*count) {
  const std::size_t begin = slot.label ? max_nonvirtual : 0;
  const std::size_t end = slot.label ? slots_.size() : max_nonvirtual;
  std::optional<std::size_t> free;
  for (std::size_t i = end; i-- > begin;) {
    if (!slots_[i]) {
      free = i;
    } else if (slots_[i]->address == slot.address && slots_[i]->label == slot.label) {
      ++(*slots_[i].*count);
      return {Status::success, static_cast<Handle>(i)};
    }
  }
  if (!free) return {Status::rejected};
  slots_[*free] = slot;
  ++(*slots_[*free].*count);
  return {Status::success, static_cast<Handle>(*free)};
}

Status AddressTable::remove_subscription(Handle handle) {
  if (find(handle) == nullptr || slots_[handle]->subscriptions == 0) return Status::rejected;
  --slots_[handle]->subscriptions;
  free_unused(handle);
  return Status::success;
}

Status AddressTable::remove_publication(Handle handle) {
  if (find(handle) == nullptr) return Status::rejected;
  --slots_[handle]->publications;
  free_unused(handle);
  return Status::success;
}

void AddressTable::free_unused(Handle handle) {
  const Slot& slot = *slots_[handle];
  if (slot.subscriptions == 0 && slot.publications == 0) slots_[handle].reset();
}

const AddressTable::Slot* AddressTable::find(Handle handle) const {
  return handle < slots_.size() && slots_[handle] ? &*slots_[handle] : nullptr;
}

bool AddressTable::restore(Handle handle, const Slot& slot) {
  const bool is_virtual_place = handle >= max_nonvirtual;
  if (handle >= slots_.size() || slot.label.has_value() != is_virtual_place) return false;
  slots_[handle] = slot;
  return true;
}

std::optional<Handle> AddressTable::subscription(Address address) const {
  for (std::size_t i = 0; i < slots_.size(); ++i) {
    if (slots_[i] && slots_[i]->address == address && slots_[i]->subscriptions > 0) {
      return static_cast<Handle>(i);
    }
  }
  return std::nullopt;
}

std::vector<Handle> AddressTable::handles() const {
  std::vector<Handle> out;
  for (std::size_t i = 0; i < slots_.size(); ++i) {
    if (slots_[i]) out.push_back(static_cast<Handle>(i));
  }
  return out;
}

}  // namespace slamgw::sim::ble
