// SPDX-License-Identifier: Apache-2.0
// The board's tables of keys and addresses ("device state manager"): fixed sizes, a handle is a
// slot, and the status codes are the ones that Nordic's firmware translates its errors to.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "simulation/ble/access.hpp"

namespace slamgw::sim::ble {

enum class Status : std::uint8_t {
  success = 0x00,
  internal = 0x81,
  command_unknown = 0x82,
  invalid_state = 0x83,
  invalid_length = 0x84,
  invalid_parameter = 0x85,
  invalid_data = 0x87,
  rejected = 0x8e,
};

using Handle = std::uint16_t;
using Key = std::array<std::uint8_t, 16>;

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
  bool remove(Handle handle);
  void remove_of_subnet(Handle subnet);
  Slot* find(Handle handle);
  const Slot* find(Handle handle) const;
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
  /// The handle under which messages to this group arrive.
  std::optional<Handle> subscription(Address address) const;
  std::vector<Handle> handles() const;

 private:
  Added add(Address address, unsigned Slot::*count);
  Status remove(Handle handle, unsigned Slot::*count);

  std::array<std::optional<Slot>, max_capacity> slots_;
};

}  // namespace slamgw::sim::ble
