// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/address_plan.hpp"

#include <algorithm>

namespace slamgw::ble {
namespace {

struct Range {
  std::uint32_t first = 0;
  std::uint32_t end = 0;

  Range(std::uint16_t address, std::uint8_t elements) : first(address), end(address + elements) {}
  bool overlaps(const Range& other) const { return first < other.end && other.first < end; }
};

/// Which of all unicast addresses are in use.
class Occupancy {
 public:
  void add(const Range& range) {
    for (std::uint32_t address = range.first; address < range.end; ++address)
      if (address <= last_unicast_address) used_[address] = true;
  }
  bool has_room(std::uint32_t address, std::uint8_t elements) const {
    if (address + elements > last_unicast_address + 1U) return false;
    const auto first = used_.begin() + address;
    return std::find(first, first + elements, true) == first + elements;
  }
  std::optional<std::uint16_t> first_room(std::uint32_t from, std::uint8_t elements) const {
    for (std::uint32_t address = from; address <= last_unicast_address; ++address)
      if (has_room(address, elements)) return static_cast<std::uint16_t>(address);
    return std::nullopt;
  }

 private:
  std::vector<bool> used_ = std::vector<bool>(last_unicast_address + 1U);
};

}  // namespace

bool is_address_free(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements,
                     const std::set<std::uint16_t>& taken, const std::optional<Uuid>& own) {
  const Range wanted(address, elements);
  if (address == 0 || wanted.end > last_unicast_address + 1U) return false;
  const auto next_taken = taken.lower_bound(address);
  if (next_taken != taken.end() && *next_taken < wanted.end) return false;
  return std::ranges::none_of(database.nodes, [&](const Node& node) {
    return node.uuid != own && (Range(node.address, node.elements).overlaps(wanted) ||
                                Range(node.joining_address(), node.elements).overlaps(wanted));
  });
}

std::uint16_t source_room(const NodeDatabase& database, std::uint16_t address,
                          const std::set<std::uint16_t>& taken) {
  const std::uint32_t end =
      address < first_robot_address ? first_robot_address : last_unicast_address + 1U;
  std::uint16_t room = 0;
  while (room < max_sources && address + room < end) {
    const auto next = static_cast<std::uint16_t>(address + room);
    if (!is_address_free(database, next, 1, taken, {})) break;
    ++room;
  }
  return room;
}

bool was_used_before(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements) {
  const Range wanted(address, elements);
  return std::ranges::any_of(database.removed, [&](const RemovedNode& node) {
    return Range(node.address, node.elements).overlaps(wanted);
  });
}

std::optional<std::uint16_t> choose_address(const NodeDatabase& database, const AddressWish& wish) {
  Occupancy occupied;
  for (const Node& node : database.nodes) {
    occupied.add(Range(node.address, node.elements));
    occupied.add(Range(node.joining_address(), node.elements));
  }
  for (const std::uint16_t address : wish.taken) occupied.add(Range(address, 1));
  Occupancy remembered = occupied;
  for (const RemovedNode& node : database.removed)
    remembered.add(Range(node.address, node.elements));

  for (const std::uint16_t address : wish.preferred)
    if (remembered.has_room(address, wish.elements)) return address;
  if (const auto next = remembered.first_room(database.next_address, wish.elements)) return next;
  if (const auto passed_over = remembered.first_room(first_robot_address, wish.elements))
    return passed_over;
  for (const RemovedNode& node : database.removed)
    if (node.address >= first_robot_address && occupied.has_room(node.address, wish.elements))
      return node.address;
  return std::nullopt;
}

}  // namespace slamgw::ble
