// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

#include <algorithm>
#include <charconv>
#include <system_error>

namespace slamgw::ble {

std::optional<Uuid> parse_uuid(std::string_view text) {
  std::string digits(text);
  std::erase(digits, '-');
  Uuid uuid{};
  if (digits.size() != uuid.size() * 2) return std::nullopt;
  for (std::size_t i = 0; i < uuid.size(); ++i) {
    const char* const first = digits.data() + 2 * i;
    const auto [end, error] = std::from_chars(first, first + 2, uuid[i], 16);
    if (error != std::errc{} || end != first + 2) return std::nullopt;
  }
  return uuid;
}

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
  if (node->new_address != 0) retire(node->new_address, node->elements, Uuid{});
  retire(node->address, node->elements, uuid);
  std::erase_if(nodes, [&](const Node& other) { return other.uuid == uuid; });
}

void NodeDatabase::retire(std::uint16_t address, std::uint8_t elements, const Uuid& uuid) {
  forget_removed(uuid);
  if (removed.size() >= max_removed) removed.erase(removed.begin());
  removed.push_back({uuid, address, elements});
}

void NodeDatabase::forget_removed(const Uuid& uuid) {
  for (RemovedNode& node : removed)
    if (node.uuid == uuid) node.uuid = Uuid{};
}

}  // namespace slamgw::ble
