// SPDX-License-Identifier: Apache-2.0
// Nodes are told how to live in the mesh, and put out of it.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"

namespace slamgw::ble {

bool Provisioner::wants_configuration(const Node& node) const {
  if (is_guest()) return false;
  const bool is_behind = node.state == NodeState::provisioned || is_outdated(node);
  return is_behind && !conversations_.contains(node.address) &&
         !(session_ && session_->uuid() == node.uuid);
}

/// Configured otherwise than the settings say. Who was not configured by this is left alone.
bool Provisioner::is_outdated(const Node& node) const {
  if (node.state != NodeState::configured || !node.told) return false;
  return node.told->is_changing || node.ttl != settings_.ttl ||
         node.told->gateway_address != settings_.address ||
         !std::ranges::is_permutation(node.told->groups, settings_.groups);
}

/// True when the disk has to know first: a change that breaks off half-way is not forgotten, even
/// when the settings are changed back meanwhile.
bool Provisioner::begin_changes() {
  const auto is_new = [&](const Node& node) {
    return is_outdated(node) && !node.told->is_changing;
  };
  if (std::ranges::none_of(database()->nodes, is_new)) return false;
  for (Node& node : ledger_.change().nodes)
    if (is_new(node)) node.told->is_changing = true;
  actions_.push(NodesChanged{});
  return true;
}

void Provisioner::begin_conversations(TimePoint now) {
  if (!next_configuration() || *next_configuration() > now) return;
  if (begin_changes()) return;
  if (!is_swept_) {
    if (!sweep_) sweep_.emplace();
    if (!sweep_->is_done()) return;
    is_swept_ = true;
    sweep_.reset();
  }
  const ConfigurationSettings settings{database()->keys.app_key, settings_.address, settings_.ttl,
                                       settings_.groups};
  const auto begin = [&](const Node& node, NodeConfiguration::Purpose purpose) {
    conversations_.try_emplace(node.address, node, purpose, settings, subnet_handle_);
  };
  if (is_ordered(OrderKind::remove)) {
    const Node* node = database()->find(order_->uuid);
    if (node != nullptr && !conversations_.contains(node->address))
      begin(*node, NodeConfiguration::Purpose::reset);
  }
  while (conversations_.size() < max_conversations) {
    const Node* node = next_node(now);
    if (node == nullptr) return;
    begin(*node, NodeConfiguration::Purpose::configure);
  }
}

/// Who is there comes first, then who waits longest: those that are switched off hold up nobody.
const Node* Provisioner::next_node(TimePoint now) {
  const Node* next = nullptr;
  std::pair<bool, TimePoint> next_turn;
  for (const Node& node : database()->nodes) {
    const Upkeep& upkeep = upkeep_[node.uuid];
    if (!wants_configuration(node) || upkeep.retry_at > now) continue;
    const std::pair turn{!upkeep.heard_at && !upkeep.joined_at, upkeep.retry_at};
    if (next == nullptr || turn < next_turn) {
      next = &node;
      next_turn = turn;
    }
  }
  return next;
}

std::optional<TimePoint> Provisioner::next_configuration() const {
  if (!is_up_ || !database() || !ledger_.is_saved()) return std::nullopt;
  if (conversations_.size() >= max_conversations) return std::nullopt;
  if (chosen_ && chosen_->needs_restart) return std::nullopt;
  if (!is_swept_ && !conversations_.empty()) return std::nullopt;
  if (sweep_ && !sweep_->is_done()) return std::nullopt;
  std::optional<TimePoint> next;
  if (is_ordered(OrderKind::remove)) {
    const Node* node = database()->find(order_->uuid);
    if (node != nullptr && !conversations_.contains(node->address)) next = TimePoint::min();
  }
  for (const Node& node : database()->nodes) {
    if (!wants_configuration(node)) continue;
    const auto upkeep = upkeep_.find(node.uuid);
    next = earlier(next, upkeep == upkeep_.end() ? TimePoint::min() : upkeep->second.retry_at);
  }
  return next;
}

void Provisioner::end_conversation(NodeConfiguration conversation, TimePoint now) {
  if (conversation.is_key_table_unclear()) is_swept_ = false;
  const Node* node = database()->find_address(conversation.address());
  if (node == nullptr) return;
  const bool is_done = conversation.state() == NodeConfiguration::State::succeeded;
  switch (conversation.purpose()) {
    case NodeConfiguration::Purpose::reset:
      return on_reset(*node, is_done, conversation.problem(), now);
    case NodeConfiguration::Purpose::configure: break;
  }
  if (is_done && conversation.problem().empty()) return on_configured(*node);
  on_not_configured(*node, conversation.problem(), now);
}

void Provisioner::on_configured(const Node& known) {
  Node& node = *ledger_.change().find(known.uuid);
  const Node before = node;
  node.state = NodeState::configured;
  node.ttl = settings_.ttl;
  node.told = Told{settings_.address, settings_.groups};
  Upkeep& upkeep = upkeep_[node.uuid];
  upkeep.failures = 0;
  upkeep.problem.clear();
  actions_.push(NodesChanged{});
  const std::string id = id_of(node.address);
  if (is_outdated(before))
    return say(Severity::notice, fmt::format("{} is configured anew: {}", id, changes_from(before)),
               id);
  permit_.on_configured(node.uuid, id);
  say(Severity::notice, fmt::format("{} is configured", id), id);
  if (is_ordered(OrderKind::provision, node.uuid)) answer(node_json(node));
}

std::string Provisioner::changes_from(const Node& before) const {
  std::vector<std::string> changes;
  if (before.told->gateway_address != settings_.address)
    changes.push_back(fmt::format("it publishes to 0x{:04x}", settings_.address));
  if (before.ttl != settings_.ttl) changes.push_back(fmt::format("its TTL is {}", settings_.ttl));
  if (!std::ranges::is_permutation(before.told->groups, settings_.groups))
    changes.push_back(settings_.groups.empty() ? "it has no groups"
                                               : fmt::format("its groups are 0x{:04x}",
                                                             fmt::join(settings_.groups, ", 0x")));
  if (changes.empty()) return "as it was before";
  return fmt::format("{}", fmt::join(changes, "; "));
}

void Provisioner::on_not_configured(const Node& node, const std::string& problem, TimePoint now) {
  Upkeep& upkeep = upkeep_[node.uuid];
  const Duration pause = pause_after(++upkeep.failures);
  upkeep.retry_at = now + pause;
  upkeep.problem = problem;
  permit_.on_failed(node.uuid, problem);
  const std::string id = id_of(node.address);
  const bool has_old = node.state == NodeState::configured;
  say(Severity::warning,
      fmt::format("{} {}: {}; the next attempt is in {} s", id,
                  has_old ? "still has its old configuration" : "is in the mesh but not configured",
                  problem, std::chrono::duration_cast<std::chrono::seconds>(pause).count()),
      id);
  if (!has_old && is_ordered(OrderKind::provision, node.uuid)) answer(node_json(node));
}

void Provisioner::on_reset(const Node& node, bool is_done, const std::string& problem,
                           TimePoint now) {
  const bool is_ordered_now = is_ordered(OrderKind::remove, node.uuid);
  const std::string id = id_of(node.address);
  upkeep_[node.uuid].retry_at = now;
  if (!is_done && !(is_ordered_now && order_->is_forced)) {
    if (is_ordered_now)
      refuse(
          fmt::format("{} is still in the mesh: {}; bring it in reach, or have it forgotten "
                      "with --force",
                      id, problem));
    return;
  }
  const std::string json = node_json(node);
  forget(node);
  say(Severity::notice, fmt::format("{} was put out of the mesh", id), id);
  if (is_ordered_now) answer(json);
}

void Provisioner::forget(const Node& node) {
  const Uuid uuid = node.uuid;
  ledger_.change().remove(uuid);
  upkeep_.erase(uuid);
  candidates_.erase(uuid);
  actions_.push(NodesChanged{});
}

const std::string* Provisioner::configured_name(std::uint16_t address) const {
  for (const RobotName& name : names_.configured())
    if (name.ble_address == address) return &name.id;
  return nullptr;
}

std::string Provisioner::id_of(std::uint16_t address) const {
  const Node* node = database() ? database()->find_address(address) : nullptr;
  if (node == nullptr) return names_.of_ble(address);
  if (!node->name.empty() && configured_name(node->address) == nullptr) return node->name;
  return names_.of_ble(node->address);
}

}  // namespace slamgw::ble
