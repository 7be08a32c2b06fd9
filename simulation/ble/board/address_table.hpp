// SPDX-License-Identifier: Apache-2.0
// The board's table of addresses: groups and unicast addresses, and after them virtual addresses.
// A handle is shared by an address's subscriptions and publications, which are counted.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "simulation/ble/board/key_table.hpp"

namespace slamgw::sim::ble {

class AddressTable {
 public:
  struct Slot {
    Address address;
    std::optional<Key> label{};  ///< of a virtual address
    std::uint16_t subscriptions = 0;
    /// Nordic's firmware also decrements it for an address that was never added as a destination:
    /// the count wraps, and the address is never removed.
    std::uint16_t publications = 0;
  };
  static constexpr std::size_t max_nonvirtual = 32;
  static constexpr std::size_t max_virtual = 8;

  Added add_subscription(Address address) { return add({address}, &Slot::subscriptions); }
  Added add_publication(Address address) { return add({address}, &Slot::publications); }
  Added add_virtual_subscription(const Key& label);
  Added add_virtual_publication(const Key& label);
  Status remove_subscription(Handle handle);
  Status remove_publication(Handle handle);

  const Slot* find(Handle handle) const;
  /// Restores an entry from a state file; returns false for an invalid handle.
  bool restore(Handle handle, const Slot& slot);
  /// Returns the handle for messages to this group or virtual address.
  std::optional<Handle> subscription(Address address) const;
  std::vector<Handle> handles() const;

 private:
  Added add(const Slot& slot, std::uint16_t Slot::*count);
  void free_unused(Handle handle);

  std::array<std::optional<Slot>, max_nonvirtual + max_virtual> slots_;
};

}  // namespace slamgw::sim::ble
