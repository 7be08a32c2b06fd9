// SPDX-License-Identifier: Apache-2.0
// The board's tables of keys and addresses ("device state manager"): fixed sizes, a handle is a
// slot, and the status codes are the ones that Nordic's firmware translates its errors to.
#pragma once

#include <array>
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

/// Subnets, application keys or device keys.
class KeyTable {
 public:
  struct Slot {
    std::uint16_t index;  ///< key index, or the owner's address for device keys
    Handle subnet;        ///< for subnets: 0
    Key key;
  };

  KeyTable(std::size_t capacity, Handle first_handle)
      : slots_(capacity), first_handle_(first_handle) {}

  /// The index exists with the same key: `internal` (so the firmware reports it); with another key,
  /// or no room: `rejected`.
  Added add(std::uint16_t index, Handle subnet, const Key& key);
  /// Into its place again, from a state file; false when there is no such place.
  bool restore(Handle handle, const Slot& slot);
  bool remove(Handle handle);
  void remove_of_subnet(Handle subnet);
  Slot* find(Handle handle);
  const Slot* find(Handle handle) const;
  std::vector<Handle> handles() const;
  /// The entry with this key, on this subnet.
  std::optional<Handle> find_key(const Key& key, Handle subnet) const;
  /// The first used handle; the one of key index 0 if there is one.
  std::optional<Handle> primary() const;
  std::vector<std::uint16_t> indexes() const;
  std::vector<std::uint16_t> indexes_of_subnet(Handle subnet) const;
  std::uint16_t capacity() const { return static_cast<std::uint16_t>(slots_.size()); }

 private:
  std::vector<std::optional<Slot>> slots_;
  Handle first_handle_;
};

/// Group and unicast addresses; a handle is shared by an address's subscriptions and publications,
/// which are counted.
class AddressTable {
 public:
  struct Slot {
    Address address;
    unsigned subscriptions = 0;
    unsigned publications = 0;
  };
  static constexpr std::size_t max_capacity = 32;

  Added add_subscription(Address address) { return add(address, &Slot::subscriptions); }
  Added add_publication(Address address) { return add(address, &Slot::publications); }
  Status remove_subscription(Handle handle) { return remove(handle, &Slot::subscriptions); }
  Status remove_publication(Handle handle) { return remove(handle, &Slot::publications); }

  const Slot* find(Handle handle) const;
  /// Into its place again, from a state file; false when there is no such place.
  bool restore(Handle handle, const Slot& slot);
  /// The handle under which messages to this group arrive.
  std::optional<Handle> subscription(Address address) const;
  std::vector<Handle> handles() const;

 private:
  Added add(Address address, unsigned Slot::*count);
  Status remove(Handle handle, unsigned Slot::*count);

  std::array<std::optional<Slot>, max_capacity> slots_;
};

/// What the board keeps over a reset.
struct BoardFlash {
  KeyTable subnets{8, 0};
  KeyTable appkeys{8, 0};
  KeyTable devkeys{10, 8};  ///< handles follow those of the application keys
  AddressTable addresses;
  Address local_start = 0;
  std::uint16_t local_count = 0;
  std::uint32_t reserved_sequence = 0;  ///< numbers below may have been used
};

}  // namespace slamgw::sim::ble
