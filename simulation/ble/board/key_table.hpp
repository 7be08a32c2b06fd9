// SPDX-License-Identifier: Apache-2.0
// One of the board's tables of keys: networks, applications or devices. It has a fixed size; a
// handle is a slot, and a key gets the lowest free one.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "simulation/ble/access.hpp"
#include "simulation/ble/board/reply.hpp"

namespace slamgw::sim::ble {

using Handle = std::uint16_t;

struct Added {
  Status status = Status::success;
  Handle handle = 0;  ///< meaningful on success only
};

inline Reply reply_of(const Added& added) {
  return added.status == Status::success ? reply_with(added.handle) : Reply{added.status};
}

class KeyTable {
 public:
  struct Slot {
    std::uint16_t index;  ///< key index, or the owner's address for device keys
    Handle subnet;        ///< for subnets: 0
    Key key;
    std::optional<Key> new_key{};  ///< during a key refresh
  };

  KeyTable(std::size_t capacity, Handle first_handle)
      : slots_(capacity), first_handle_(first_handle) {}

  /// Adds a key. A known index with the same key, on any subnet: `internal`, as the firmware
  /// reports it. With another key, or a full table: `rejected`. During a key refresh the former key
  /// counts.
  Added add(std::uint16_t index, Handle subnet, const Key& key);
  /// Begins a key refresh, or repeats it; another new key is `invalid_state`. The handle is known.
  Status update(Handle handle, const Key& new_key);
  /// Restores an entry from a state file; returns false for an invalid handle.
  bool restore(Handle handle, const Slot& slot);
  bool remove(Handle handle);
  void remove_of_subnet(Handle subnet);
  const Slot* find(Handle handle) const;
  std::vector<Handle> handles() const;
  /// Returns the entry with this key, old or new, on this subnet.
  std::optional<Handle> find_key(const Key& key, Handle subnet) const;
  /// Returns the handle of key index 0, else the first used one.
  std::optional<Handle> primary() const;
  /// In the order of handles.
  std::vector<std::uint16_t> indexes() const;
  std::vector<std::uint16_t> indexes_of_subnet(Handle subnet) const;
  std::uint16_t capacity() const { return static_cast<std::uint16_t>(slots_.size()); }

 private:
  std::vector<std::optional<Slot>> slots_;
  Handle first_handle_;
};

}  // namespace slamgw::sim::ble
