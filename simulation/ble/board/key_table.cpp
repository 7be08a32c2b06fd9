// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/key_table.hpp"

namespace slamgw::sim::ble {

Added KeyTable::add(std::uint16_t index, Handle subnet, const Key& key) {
  std::optional<std::size_t> free;
  for (std::size_t i = slots_.size(); i-- > 0;) {
    if (!slots_[i]) {
      free = i;
    } else if (slots_[i]->index == index) {
      return {slots_[i]->key == key ? Status::internal : Status::rejected};
    }
  }
  if (!free) return {Status::rejected};
  slots_[*free] = Slot{index, subnet, key};
  return {Status::success, static_cast<Handle>(first_handle_ + *free)};
}

const KeyTable::Slot* KeyTable::find(Handle handle) const {
  const std::size_t i = static_cast<std::size_t>(handle) - first_handle_;
  if (handle < first_handle_ || i >= slots_.size() || !slots_[i]) return nullptr;
  return &*slots_[i];
}

Status KeyTable::update(Handle handle, const Key& new_key) {
  std::optional<Key>& refreshed = slots_[static_cast<std::size_t>(handle - first_handle_)]->new_key;
  if (refreshed && *refreshed != new_key) return Status::invalid_state;
  refreshed = new_key;
  return Status::success;
}

bool KeyTable::restore(Handle handle, const Slot& slot) {
  if (handle < first_handle_ || handle - first_handle_ >= capacity()) return false;
  slots_[static_cast<std::size_t>(handle - first_handle_)] = slot;
  return true;
}

std::vector<Handle> KeyTable::handles() const {
  std::vector<Handle> out;
  for (std::size_t i = 0; i < slots_.size(); ++i) {
    if (slots_[i]) out.push_back(static_cast<Handle>(first_handle_ + i));
  }
  return out;
}

std::optional<Handle> KeyTable::find_key(const Key& key, Handle subnet) const {
  for (const Handle handle : handles()) {
    const Slot* slot = find(handle);
    if ((slot->key == key || slot->new_key == key) && slot->subnet == subnet) return handle;
  }
  return std::nullopt;
}

bool KeyTable::remove(Handle handle) {
  if (find(handle) == nullptr) return false;
  slots_[static_cast<std::size_t>(handle - first_handle_)].reset();
  return true;
}

void KeyTable::remove_of_subnet(Handle subnet) {
  for (auto& slot : slots_) {
    if (slot && slot->subnet == subnet) slot.reset();
  }
}

std::optional<Handle> KeyTable::primary() const {
  std::optional<Handle> first;
  for (std::size_t i = slots_.size(); i-- > 0;) {
    if (!slots_[i]) continue;
    first = static_cast<Handle>(first_handle_ + i);
    if (slots_[i]->index == 0) return first;
  }
  return first;
}

std::vector<std::uint16_t> KeyTable::indexes() const {
  std::vector<std::uint16_t> out;
  for (const auto& slot : slots_) {
    if (slot) out.push_back(slot->index);
  }
  return out;
}

std::vector<std::uint16_t> KeyTable::indexes_of_subnet(Handle subnet) const {
  std::vector<std::uint16_t> out;
  for (const auto& slot : slots_) {
    if (slot && slot->subnet == subnet) out.push_back(slot->index);
  }
  return out;
}

}  // namespace slamgw::sim::ble
