// SPDX-License-Identifier: Apache-2.0
// Which unicast address a new robot gets. In this order: the addresses that `robots` names, as they
// stand there; the next free one from 0x0100; one that was passed over; at last the one whose
// robot was removed longest ago, because the other nodes' replay lists may still know it. Called by
// Admission.
#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

namespace slamgw::ble {

inline constexpr std::uint16_t first_robot_address = 0x0100;

struct AddressWish {
  std::uint8_t elements = 1;
  std::vector<std::uint16_t> preferred;
  /// Of others than nodes: the gateway, robots that another tool has taken in.
  std::set<std::uint16_t> taken;
};

/// Nothing when no room of this size is left.
std::optional<std::uint16_t> choose_address(const NodeDatabase& database, const AddressWish& wish);
/// Whether a node could have this address: `own`, or a new one.
bool is_address_free(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements,
                     const std::set<std::uint16_t>& taken, const std::optional<Uuid>& own);
/// How many addresses from `address` up a gateway can have for the lives of its radio: at most
/// `max_sources`, and none of a node, of `taken`, or of those that robots get by themselves.
std::uint16_t source_room(const NodeDatabase& database, std::uint16_t address,
                          const std::set<std::uint16_t>& taken);
/// An earlier node had it: the radio's replay list may still know it.
bool was_used_before(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements);

}  // namespace slamgw::ble
