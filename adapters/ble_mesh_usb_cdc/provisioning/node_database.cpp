// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <system_error>

namespace slamgw::ble {

std::optional<Uuid> parse_uuid(std::string_view text) {
  std::string digits(text);
  std::erase(digits, '-');
  const auto octets = from_hex(digits);
  Uuid uuid{};
  if (!octets || octets->size() != uuid.size()) return std::nullopt;
  std::ranges::copy(*octets, uuid.begin());
  return uuid;
}

std::string address_text(std::uint16_t address) { return fmt::format("0x{:04x}", address); }

std::string_view to_string(NodeState state) {
  switch (state) {
    case NodeState::reserved: return "reserved";
    case NodeState::provisioned: return "provisioned";
    case NodeState::configured: return "configured";
  }
  return "reserved";
}

std::string_view to_string(RadioKind kind) {
  switch (kind) {
    case RadioKind::unknown: break;
    case RadioKind::forgets: return "forgets";
    case RadioKind::keeps: return "keeps";
  }
  return "unknown";
}

std::string_view to_string(RefreshStep step) {
  switch (step) {
    case RefreshStep::none: break;
    case RefreshStep::distributing: return "distributing";
    case RefreshStep::switching: return "switching";
    case RefreshStep::finishing: return "finishing";
  }
  return "none";
}

RadioKeys radio_keys(const NodeDatabase& database) {
  RadioKeys keys{.keys = database.keys, .iv_index = database.iv_index};
  if (!database.refresh) return keys;
  if (database.refresh->step == RefreshStep::switching) keys.next = database.refresh->other;
  if (database.refresh->step == RefreshStep::finishing) keys.former = database.refresh->other;
  return keys;
}

const Node* NodeDatabase::find(const Uuid& uuid) const {
  const auto found = std::ranges::find(nodes, uuid, &Node::uuid);
  return found == nodes.end() ? nullptr : &*found;
}

Node* NodeDatabase::find(const Uuid& uuid) {
  const auto found = std::ranges::find(nodes, uuid, &Node::uuid);
  return found == nodes.end() ? nullptr : &*found;
}

const Node* NodeDatabase::find_address(std::uint16_t address) const {
  const auto found =
      std::ranges::find_if(nodes, [&](const Node& node) { return node.has_address(address); });
  return found == nodes.end() ? nullptr : &*found;
}

bool NodeDatabase::was_removed(const Uuid& uuid) const {
  return std::ranges::find(removed, uuid, &RemovedNode::uuid) != removed.end();
}

void NodeDatabase::remove(Uuid uuid) {
  const Node* node = find(uuid);
  if (node == nullptr) return;
  if (node->new_address != 0) retire(node->new_address, node->new_elements, Uuid{});
  retire(node->address, node->elements, uuid);
  std::erase_if(nodes, [&](const Node& other) { return other.uuid == uuid; });
}

void NodeDatabase::retire(std::uint16_t address, std::uint8_t elements, const Uuid& uuid) {
  forget_removed(uuid);
  if (removed.size() >= max_removed) {
    const auto unnamed = std::ranges::find(removed, Uuid{}, &RemovedNode::uuid);
    removed.erase(unnamed != removed.end() ? unnamed : removed.begin());
  }
  removed.push_back({uuid, address, elements});
}

void NodeDatabase::forget_removed(const Uuid& uuid) {
  for (RemovedNode& node : removed)
    if (node.uuid == uuid) node.uuid = Uuid{};
}

namespace {

struct Range {
  std::uint32_t first = 0;
  std::uint32_t end = 0;

  Range(std::uint16_t address, std::uint8_t elements) : first(address), end(address + elements) {}
  bool overlaps(const Range& other) const { return first < other.end && other.first < end; }
};

}  // namespace

bool is_address_free(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements,
                     const std::set<std::uint16_t>& taken, const std::optional<Uuid>& own) {
  const Range wanted(address, elements);
  if (address == 0 || wanted.end > last_unicast_address + 1U) return false;
  const auto next_taken = taken.lower_bound(address);
  if (next_taken != taken.end() && *next_taken < wanted.end) return false;
  return std::ranges::none_of(database.nodes, [&](const Node& node) {
    return node.uuid != own &&
           (Range(node.address, node.elements).overlaps(wanted) ||
            Range(node.joining_address(), node.joining_elements()).overlaps(wanted));
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
  const auto is_free = [&](std::uint16_t address) {
    return is_address_free(database, address, wish.elements, wish.taken, {});
  };
  const auto is_fresh = [&](std::uint16_t address) {
    return is_free(address) && !was_used_before(database, address, wish.elements);
  };
  for (const std::uint16_t address : wish.preferred)
    if (is_fresh(address)) return address;
  for (const std::uint16_t from : {database.next_address, first_robot_address})
    for (std::uint16_t address = from; address <= last_unicast_address; ++address)
      if (is_fresh(address)) return address;
  for (const RemovedNode& node : database.removed)
    if (node.address >= first_robot_address && is_free(node.address)) return node.address;
  return std::nullopt;
}

}  // namespace slamgw::ble
