// SPDX-License-Identifier: Apache-2.0
// Devices become nodes: who is next, which address it gets, and what comes of it.
#include <fmt/format.h>

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"

namespace slamgw::ble {
namespace {

bool has_prefix(const Uuid& uuid, std::string_view prefix) {
  const std::string digits = to_hex(uuid);
  return digits.size() >= prefix.size() &&
         std::equal(prefix.begin(), prefix.end(), digits.begin(), [](char wanted, char digit) {
           return (wanted >= 'A' && wanted <= 'F' ? wanted - 'A' + 'a' : wanted) == digit;
         });
}

}  // namespace

bool Provisioner::is_wanted(const Candidate& candidate, TimePoint now) const {
  const bool may_join = (settings_.provisioning.enabled || permit_.is_open()) && !is_guest();
  if (!may_join || database()->was_removed(candidate.uuid)) return false;
  if (permit_.is_open() && !permit_.admits(candidate.uuid)) return false;
  const Node* node = database()->find(candidate.uuid);
  if (node != nullptr && node->state != NodeState::reserved) {
    // It was reset by hand, unless somebody only says so in its place: the real one is still heard.
    const auto found = upkeep_.find(node->uuid);
    const auto is_past = [&](const std::optional<TimePoint>& when) {
      return !when || now - *when >= reset_silence;
    };
    const bool is_silent = found == upkeep_.end() ||
                           (is_past(found->second.heard_at) && is_past(found->second.joined_at));
    return is_silent && !conversations_.contains(node->address);
  }
  const auto& prefixes = settings_.provisioning.uuid_prefixes;
  return prefixes.empty() || std::ranges::any_of(prefixes, [&](const std::string& prefix) {
           return has_prefix(candidate.uuid, prefix);
         });
}

void Provisioner::choose_next(TimePoint now) {
  // Beacons come again and again: who is not due now will be looked at with the next one.
  if (session_ || chosen_ || is_ordered(OrderKind::scan)) return;
  if (is_ordered(OrderKind::provision)) {
    const Candidate* ordered = candidates_.find(order_->uuid, now);
    if (ordered != nullptr && reserve(*ordered, order_->robot, now))
      order_->due = now + order_time_limit;
    return;
  }
  const Candidate* next =
      candidates_.next([&](const Candidate& candidate) { return is_wanted(candidate, now); }, now);
  if (next == nullptr) return;
  const Uuid uuid = next->uuid;
  if (!reserve(*next, permit_.is_open() ? permit_.robot() : std::string(), now)) return;
  permit_.on_chosen(uuid);
}

bool Provisioner::reserve(const Candidate& candidate, const std::string& name, TimePoint now) {
  const Uuid uuid = candidate.uuid;
  const auto elements = std::max<std::uint8_t>(candidate.elements, 1);
  const bool has_room = database()->find(uuid) != nullptr || make_room();
  const auto address = has_room ? address_for(candidate, name) : std::nullopt;
  if (!address) {
    const std::string why =
        has_room ? "no unicast address is left for it"
                 : fmt::format("the mesh has {} nodes already", NodeDatabase::max_nodes);
    candidates_.on_failure(uuid, now);
    say(Severity::warning, fmt::format("the device {} was not taken in: {}", to_hex(uuid), why));
    if (is_ordered(OrderKind::provision, uuid)) refuse(why);
    return false;
  }
  NodeDatabase& database = ledger_.change();
  bool needs_restart = was_used_before(database, *address, elements);
  Node* node = database.find(uuid);
  if (node == nullptr) {
    node = &database.nodes.emplace_back();
    node->uuid = uuid;
    node->elements = elements;
  } else if (node->state != NodeState::reserved) {
    if (node->address == *address) {
      needs_restart = true;
    } else {
      database.retire(node->address, node->elements, Uuid{});
      node->state = NodeState::reserved;
    }
  }
  node->address = *address;
  if (!name.empty())
    for (Node& other : database.nodes)  // one that did not get as far as the mesh
      if (other.state == NodeState::reserved && other.name == name) other.name.clear();
  if (!name.empty()) node->name = name;
  if (!name.empty()) database.forget_removed(uuid);
  const bool is_in_order = name.empty() && configured_name(*address) == nullptr;
  if (is_in_order && *address >= database.next_address)
    database.next_address = static_cast<std::uint16_t>(*address + elements);
  chosen_ = Chosen{uuid, needs_restart};
  return true;
}

std::set<std::uint16_t> Provisioner::taken_addresses() const {
  std::set<std::uint16_t> taken = strangers_;
  taken.insert(settings_.address);
  taken.insert(database()->gateways.begin(), database()->gateways.end());
  return taken;
}

std::optional<std::uint16_t> Provisioner::address_for(const Candidate& candidate,
                                                      const std::string& name) const {
  const Node* node = database()->find(candidate.uuid);
  AddressWish wish{.elements = std::max<std::uint8_t>(candidate.elements, 1),
                   .preferred = {},
                   .taken = taken_addresses()};
  const auto is_free = [&](std::uint16_t address) {
    return is_address_free(*database(), address, wish.elements, wish.taken, candidate.uuid);
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

bool Provisioner::make_room() {
  const auto& nodes = database()->nodes;
  if (nodes.size() < NodeDatabase::max_nodes) return true;
  const auto unfinished = std::ranges::find(nodes, NodeState::reserved, &Node::state);
  if (unfinished == nodes.end()) return false;
  forget(*unfinished);
  return true;
}

void Provisioner::begin_session(TimePoint now) {
  const Node* node = database()->find(chosen_->uuid);
  const auto pair = make_key_pair(random_);
  if (node == nullptr || !pair) {
    if (!pair) say(Severity::error, "no randomness for the keys of a new robot");
    candidates_.on_failure(chosen_->uuid, now);
    if (is_ordered(OrderKind::provision, chosen_->uuid)) refuse("it can't be taken in now");
    chosen_.reset();
    return;
  }
  context_ = context_ == 0 ? 1 : 0;
  is_last_context_ = chosen_->is_last_context;
  session_.emplace(ProvisioningSession::Request{{context_, node->uuid, database()->keys.net_key,
                                                 database()->iv_index, node->address, version_},
                                                *pair,
                                                static_oob_},
                   now);
  chosen_.reset();
}

void Provisioner::keep_addresses(TimePoint now) {
  const Node* node = database()->find(session_->uuid());
  const std::uint8_t elements = session_->elements();
  candidates_.on_elements(session_->uuid(), elements);
  if (node == nullptr) return session_->fail("an operator has put it out");
  if (!is_address_free(*database(), node->address, elements, taken_addresses(), node->uuid))
    return session_->fail(
        fmt::format("its {} elements need as many addresses in a row, which 0x{:04x} does not "
                    "have; it gets others at the next attempt",
                    elements, node->address));
  if (node->elements != elements) {
    NodeDatabase& database = ledger_.change();
    database.find(session_->uuid())->elements = elements;
    const std::uint32_t end = node->address + elements;
    const bool is_in_order = node->address + 1U == database.next_address;
    if (is_in_order) database.next_address = static_cast<std::uint16_t>(end);
  }
  if (ledger_.is_saved()) session_->on_addresses(now);
}

void Provisioner::on_joined(TimePoint now) {
  const Node* known = database()->find(session_->uuid());
  const Key& device_key = *session_->device_key();
  if (known == nullptr) return;
  if (known->state != NodeState::reserved && known->device_key == device_key) return;
  Node& node = *ledger_.change().find(session_->uuid());
  node.device_key = device_key;
  node.state = NodeState::provisioned;
  node.ttl.reset();
  node.told.reset();
  candidates_.erase(node.uuid);
  Upkeep& upkeep = upkeep_[node.uuid];
  upkeep = Upkeep{};
  upkeep.joined_at = now;
  actions_.push(NodesChanged{});
  const std::string id = id_of(node.address);
  say(Severity::notice,
      fmt::format("{} is in the mesh, at 0x{:04x}, UUID {}", id, node.address, to_hex(node.uuid)),
      id);
  permit_.on_joined(node.uuid, id);
  warn_of_replay_list(node);
}

void Provisioner::warn_of_replay_list(const Node& node) {
  std::size_t sources = 0;
  for (const Node& each : database()->nodes)
    sources += each.state == NodeState::reserved ? 0 : each.elements;
  if (sources <= replay_list_size) return;
  const std::string id = id_of(node.address);
  say(Severity::warning,
      fmt::format("{} may not be heard: a stock serial board remembers {} sources, and the mesh "
                  "has {}",
                  id, replay_list_size, sources),
      id);
}

void Provisioner::on_session_failed(TimePoint now) {
  const Uuid uuid = session_->uuid();
  const std::string why = session_->failure();
  const bool has_joined = session_->device_key().has_value();
  const bool may_try_other = session_->is_context_busy() && !is_last_context_;
  const bool is_key_lost = session_->is_key_lost();
  session_.reset();
  if (has_joined) return;
  if (may_try_other) {
    chosen_ = Chosen{uuid, false, true};
    return;
  }
  permit_.on_failed(uuid, why);
  candidates_.on_failure(uuid, now);
  const Candidate* candidate = candidates_.find(uuid, now);
  const Duration pause = pause_after(candidate ? candidate->failures : 1);
  if (is_key_lost) candidates_.erase(uuid);  // until it is heard again
  const std::string what_next =
      is_key_lost ? std::string("reset it by hand, then it joins anew")
                  : fmt::format("the next attempt is in {} s if it is still there",
                                std::chrono::duration_cast<std::chrono::seconds>(pause).count());
  say(Severity::warning,
      fmt::format("the device {} was not taken in: {}; {}", to_hex(uuid), why, what_next));
  if (is_ordered(OrderKind::provision, uuid)) refuse(why);
}

}  // namespace slamgw::ble
