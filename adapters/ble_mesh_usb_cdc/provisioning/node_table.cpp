// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

namespace slamgw::ble {

namespace {

constexpr std::uint16_t first_gateway_address = 0x0001;

}  // namespace

void NodeTable::remove(Uuid uuid) {
  change().remove(uuid);
  histories_.erase(uuid);
  announce_change();
}

void NodeTable::replace(std::optional<NodeDatabase> database) {
  strangers_.clear();
  database_ = std::move(database);
  is_changed_ = database_.has_value();
  if (!is_changed_) store_retry_at_.reset();
}

void NodeTable::begin(const MeshKeys& keys) {
  database_ = NodeDatabase{.keys = keys};
  is_changed_ = is_beginning_ = true;
}

const NodeDatabase* NodeTable::take_write(TimePoint now) {
  if (!is_changed_ || is_writing_ || (store_retry_at_ && now < *store_retry_at_)) return nullptr;
  is_changed_ = false;
  is_writing_ = true;
  store_retry_at_.reset();
  return &*database_;
}

void NodeTable::on_stored(bool is_done, TimePoint now) {
  is_writing_ = false;
  const bool was_beginning = std::exchange(is_beginning_, false);
  if (is_done) return;
  if (was_beginning) return database_.reset();
  is_changed_ = true;
  store_retry_at_ = now + store_retry_interval;
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

const Node* NodeTable::holder_of(const std::string& name, std::uint16_t address) const {
  const Node* holder = nullptr;
  const std::string* wanted = &name;
  for (std::size_t i = 0; database() && i <= database()->nodes.size(); ++i) {
    const auto next = std::ranges::find_if(database()->nodes, [&](const Node& node) {
      return node.state != NodeState::reserved && !node.has_address(address) &&
             node.name == *wanted;
    });
    if (next == database()->nodes.end()) return nullptr;
    if (holder == nullptr) holder = &*next;
    address = next->address;
    wanted = configured_name(address);
    if (wanted == nullptr) return holder;
  }
  return nullptr;  // nodes exchange their names
}

std::string NodeTable::id_of(std::uint16_t address) const {
  const Node* node = find(address);
  if (node != nullptr) address = node->address;
  const std::string* configured = configured_name(address);
  if (configured != nullptr && holder_of(*configured, address) == nullptr) return *configured;
  return node != nullptr && !node->name.empty() ? node->name : RobotNames().of_ble(address);
}

bool NodeTable::is_elsewhere(const std::string& id, std::uint16_t address) const {
  return database() != nullptr && std::ranges::any_of(database()->nodes, [&](const Node& node) {
           return node.state != NodeState::reserved && !node.has_address(address) &&
                  id_of(node.address) == id;
         });
}

// --- Since the start -----------------------------------------------------------------------------

void NodeTable::on_heard(std::uint16_t address, TimePoint now) {
  const Node* node = find(address);
  if (node == nullptr) {
    if (strangers_.size() >= NodeDatabase::max_nodes)
      std::erase_if(strangers_, [](const auto& each) { return each.second < believed_after; });
    if (strangers_.contains(address) || strangers_.size() < NodeDatabase::max_nodes)
      strangers_[address] = std::min(strangers_[address] + 1, believed_after);
    return;
  }
  NodeHistory& history = histories_[node->uuid];
  const bool was_silent = !history.heard_at || now - *history.heard_at > settings_.offline_after;
  history.heard_at = now;
  if (was_silent && history.failures > 0) history.retry_at = now;  // the node is in reach again
}

const NodeHistory* NodeTable::find_history(const Uuid& uuid) const {
  const auto found = histories_.find(uuid);
  return found == histories_.end() ? nullptr : &found->second;
}

// --- Addresses -----------------------------------------------------------------------------------

std::set<std::uint16_t> NodeTable::taken_addresses() const {
  std::set<std::uint16_t> taken;
  for (const auto& [address, times] : strangers_) taken.insert(address);
  const auto add = [&](std::uint16_t gateway, std::uint32_t end) {
    taken.insert(gateway);
    for (std::uint32_t address = gateway; address < end; ++address)
      if (const auto each = static_cast<std::uint16_t>(address); find(each) == nullptr)
        taken.insert(each);
  };
  add(settings_.address,
      std::max<std::uint32_t>(settings_.address + source_room(), database()->life.source + 1U));
  for (const std::uint16_t gateway : database()->gateways)
    add(gateway, std::min<std::uint32_t>(gateway + max_sources, first_robot_address));
  return taken;
}

std::uint16_t NodeTable::room_at(std::uint16_t gateway) const {
  std::set<std::uint16_t> others{settings_.address};
  for (const auto& [address, times] : strangers_)
    if (times == believed_after) others.insert(address);
  others.insert(database()->gateways.begin(), database()->gateways.end());
  for (const RobotName& name : names_.configured())
    if (name.ble_address) others.insert(*name.ble_address);
  others.erase(gateway);
  return std::max<std::uint16_t>(ble::source_room(*database(), gateway, others), 1);
}

bool NodeTable::is_own(std::uint16_t address) const {
  if (database() == nullptr || find(address) != nullptr || configured_name(address) != nullptr)
    return false;
  const RadioLife& life = database()->life;
  const std::uint32_t end = settings_.address + std::min<std::uint32_t>(life.number, max_sources);
  return address >= settings_.address && address < end && address <= life.source;
}

std::uint16_t NodeTable::source_room() const {
  const std::uint16_t room = room_at(settings_.address);
  return is_guest() ? std::min(room, database()->guest_addresses) : room;
}

std::optional<std::uint16_t> NodeTable::address_for(const Uuid& uuid, std::uint8_t elements,
                                                    const std::string& name) const {
  const Node* node = database()->find(uuid);
  // A node that had joined needs another address: the radio would drop its new, low numbers.
  const bool was_joined = node != nullptr && node->state != NodeState::reserved;
  AddressWish wish{.elements = elements, .preferred = {}, .taken = taken_addresses()};
  for (const Node& other : database()->nodes)  // a new robot there would get its name
    if (const auto named = names_.ble_address_of(other.name); named && other.uuid != uuid)
      wish.taken.insert(*named);
  const auto is_free = [&](std::uint16_t address) {
    return is_address_free(*database(), address, elements, wish.taken, uuid);
  };
  if (const auto named = name.empty() ? std::nullopt : names_.ble_address_of(name)) {
    const bool is_known =
        (was_joined && node->has_address(*named)) || was_used_before(*database(), *named, elements);
    if (!is_known) return is_free(*named) ? named : std::nullopt;
  }
  // The configuration's name for an address would win over the operator's.
  const std::uint16_t reserved = node == nullptr ? 0
                                 : was_joined    ? node->new_address
                                                 : node->address;
  const bool may_stay = reserved != 0 && (name.empty() || configured_name(reserved) == nullptr);
  if (may_stay && is_free(reserved)) return reserved;
  for (const RobotName& configured : names_.configured()) {
    if (!configured.ble_address) continue;
    if (name.empty() && !was_joined) {
      wish.preferred.push_back(*configured.ble_address);
    } else {
      wish.taken.insert(*configured.ble_address);
    }
  }
  return choose_address(*database(), wish);
}

std::optional<std::uint16_t> NodeTable::address_for_gateway() const {
  std::set<std::uint16_t> taken = taken_addresses();
  for (const RobotName& name : names_.configured())
    if (name.ble_address) taken.insert(*name.ble_address);
  std::optional<std::uint16_t> best;
  std::uint16_t most = 0;
  for (std::uint16_t address = first_gateway_address; address < first_robot_address; ++address) {
    if (was_used_before(*database(), address, 1)) continue;
    const std::uint16_t room = ble::source_room(*database(), address, taken);
    if (room > most) best = address;
    most = std::max(most, room);
  }
  return best;
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
