// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "adapters/ble_mesh_usb_cdc/provisioning/address_plan.hpp"

namespace slamgw::ble {
namespace {

constexpr std::uint16_t first_gateway_address = 0x0001;

}  // namespace

void NodeTable::remove(Uuid uuid) {
  ledger_.change().remove(uuid);
  histories_.erase(uuid);
  announce_change();
}

void NodeTable::replace(NodeDatabase database) {
  strangers_.clear();
  ledger_.begin(std::move(database), false);
}

const Node* NodeTable::find_joined(std::uint16_t address) const {
  const Node* node = find(address);
  return node != nullptr && node->state != NodeState::reserved ? node : nullptr;
}

// --- Names ---------------------------------------------------------------------------------------

const std::string* NodeTable::configured_name(std::uint16_t address) const {
  for (const RobotName& name : names_.configured())
    if (name.ble_address == address) return &name.id;
  return nullptr;
}

std::string NodeTable::id_of(std::uint16_t address) const {
  const Node* node = find(address);
  if (node == nullptr) return names_.of_ble(address);
  if (!node->name.empty() && configured_name(node->address) == nullptr) return node->name;
  return names_.of_ble(node->address);
}

// --- Since the start -----------------------------------------------------------------------------

void NodeTable::on_heard(std::uint16_t address, TimePoint now) {
  const Node* node = find(address);
  if (node == nullptr) {
    if (strangers_.size() < NodeDatabase::max_nodes) strangers_.insert(address);
    return;
  }
  NodeHistory& history = histories_[node->uuid];
  const bool was_silent = !history.heard_at || now - *history.heard_at > settings_.offline_after;
  history.heard_at = now;
  if (was_silent && history.failures > 0) history.retry_at = now;  // it is in reach again
}

const NodeHistory* NodeTable::find_history(const Uuid& uuid) const {
  const auto found = histories_.find(uuid);
  return found == histories_.end() ? nullptr : &found->second;
}

// --- Addresses -----------------------------------------------------------------------------------

std::set<std::uint16_t> NodeTable::taken_addresses() const {
  std::set<std::uint16_t> taken = strangers_;
  taken.insert(settings_.address);
  taken.insert(database()->gateways.begin(), database()->gateways.end());
  return taken;
}

std::optional<std::uint16_t> NodeTable::address_for(const Uuid& uuid, std::uint8_t elements,
                                                    const std::string& name) const {
  const Node* node = database()->find(uuid);
  AddressWish wish{.elements = elements, .preferred = {}, .taken = taken_addresses()};
  const auto is_free = [&](std::uint16_t address) {
    return is_address_free(*database(), address, elements, wish.taken, uuid);
  };
  if (const auto named = name.empty() ? std::nullopt : names_.ble_address_of(name))
    return is_free(*named) ? named : std::nullopt;
  // The configuration's name for an address would win over the operator's.
  const bool may_stay =
      node != nullptr && (name.empty() || configured_name(node->address) == nullptr);
  if (may_stay && is_free(node->address)) return node->address;
  for (const RobotName& configured : names_.configured()) {
    if (!configured.ble_address) continue;
    if (name.empty()) {
      wish.preferred.push_back(*configured.ble_address);
    } else {
      wish.taken.insert(*configured.ble_address);
    }
  }
  return choose_address(*database(), wish);
}

std::optional<std::uint16_t> NodeTable::address_for_gateway() const {
  const std::set<std::uint16_t> taken = taken_addresses();
  for (std::uint16_t address = first_gateway_address; address < first_robot_address; ++address)
    if (configured_name(address) == nullptr && !was_used_before(*database(), address, 1) &&
        is_address_free(*database(), address, 1, taken, {}))
      return address;
  return std::nullopt;
}

// --- For operators -------------------------------------------------------------------------------

std::string NodeTable::json() const {
  std::string rows;
  if (database() == nullptr) return "[]";
  for (const Node& node : database()->nodes) rows += (rows.empty() ? "" : ",") + json(node);
  return "[" + rows + "]";
}

std::string NodeTable::json(const Node& node) const {
  const NodeHistory* history = find_history(node.uuid);
  return nlohmann::ordered_json{{"robot", id_of(node.address)},
                                {"uuid", to_hex(node.uuid)},
                                {"address", fmt::format("0x{:04x}", node.address)},
                                {"elements", node.elements},
                                {"state", to_string(node.state)},
                                {"problem", history ? history->problem : ""}}
      .dump();
}

}  // namespace slamgw::ble
