// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_conversations.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <tuple>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_report.hpp"

namespace slamgw::ble {

// --- Inputs --------------------------------------------------------------------------------------

bool NodeConversations::on_message(const MessageReceived& message, TimePoint now) {
  return std::ranges::any_of(conversations_,
                             [&](auto& each) { return each.second.on_message(message, now); });
}

void NodeConversations::on_send_refused(std::uint16_t address, const std::string& why,
                                        TimePoint now) {
  const auto found = conversations_.find(address);
  if (found != conversations_.end()) found->second.on_send_refused(why, now);
}

void NodeConversations::on_key_used(const DeviceKeyUsed& used, TimePoint now) {
  const auto found = conversations_.find(used.address);
  if (found != conversations_.end()) found->second.on_key_used(used.problem, now);
}

void NodeConversations::on_beacon(const Uuid& uuid, TimePoint now) {
  const Node* node = nodes_.find(uuid);
  if (node == nullptr || !admission_.was_silent(*node, Admission::removal_silence, now)) return;
  const auto found = conversations_.find(node->address);
  if (found != conversations_.end()) found->second.on_beacon(now);
}

// --- The next node -------------------------------------------------------------------------------

bool NodeConversations::needs_configuration(const Node& node) const {
  if (nodes_.is_guest()) return false;
  const bool is_behind =
      node.state == NodeState::provisioned || refresh_.is_due(node) || is_outdated(node);
  return is_behind && !is_talking_with(node) && !admission_.is_joining(node.uuid);
}

/// Returns true if the node's configuration differs from the settings. A node that another tool
/// configured is left alone.
bool NodeConversations::is_outdated(const Node& node) const {
  if (node.state != NodeState::configured || !node.applied) return false;
  return node.applied->is_changing || node.ttl != ttl_of(node) ||
         node.applied->destination != destination() || !has_right_groups(node);
}

/// Returns true if only the node's publications have to move to the address of the radio's present
/// life. Until then, a board hears messages to the old address, too. But it acknowledges their
/// segments from the old address, which the robot ignores. BlueZ's node hears none of them.
bool NodeConversations::is_only_moved(const Node& node) const {
  const auto is_own = [&](std::uint32_t address) {
    return address >= settings_.address && address < settings_.address + std::uint32_t{max_sources};
  };
  return node.state == NodeState::configured && node.applied && !node.applied->is_changing &&
         node.ttl == ttl_of(node) && is_own(node.applied->destination) && is_own(destination()) &&
         has_right_groups(node);
}

std::vector<std::uint16_t> NodeConversations::groups_of(const Node& node) const {
  std::vector<std::uint16_t> groups = settings_.groups;
  for (const std::uint16_t group : node.wishes.groups)
    if (std::ranges::find(groups, group) == groups.end()) groups.push_back(group);
  return groups;
}

bool NodeConversations::has_right_groups(const Node& node) const {
  return std::ranges::is_permutation(node.applied->groups, groups_of(node)) &&
         node.applied->relay_group == settings_.relayed_to();
}

/// Marks the nodes whose configuration will be changed. Returns true if there are some: the marks
/// must be on disk first. So a change that breaks off half-way is completed later, even if the
/// settings are changed back.
bool NodeConversations::begin_changes() {
  const auto is_new = [&](const Node& node) {
    return is_outdated(node) && !node.applied->is_changing && !is_only_moved(node);
  };
  if (std::ranges::none_of(nodes_.database()->nodes, is_new)) return false;
  for (Node& node : nodes_.change().nodes)
    if (is_new(node)) node.applied->is_changing = true;
  nodes_.announce_change();
  return true;
}

void NodeConversations::begin_due(TimePoint now) {
  if (!next_begin() || *next_begin() > now) return;
  if (begin_changes()) return;
  const auto begin = [&](const Node& node, NodeConfiguration::Purpose purpose,
                         std::vector<ConfigurationStep> questions = {}) {
    const NodeDatabase& database = *nodes_.database();
    const ConfigurationSettings settings{.app_key = database.keys.app_key,
                                         .destination = destination(),
                                         .ttl = ttl_of(node),
                                         .groups = groups_of(node),
                                         .relay_group = settings_.relayed_to(),
                                         .wishes = node.wishes,
                                         .refresh = database.refresh.value_or(RefreshState{}),
                                         .questions = std::move(questions)};
    conversations_.try_emplace(node.address, node, purpose, settings, radio_);
  };
  if (const Node* node = ordered_node()) begin(*node, *ordered_purpose());
  while (conversations_.size() < max_conversations) {
    const Node* node = next_node(now);
    if (node == nullptr) break;
    begin(*node, purpose_for(*node));
  }
  if (conversations_.size() >= max_conversations || !survey_due()) return;
  const Node* surveyed = nodes_.find(survey_.address());
  auto questions = survey_.next(now);
  if (!questions.empty())
    begin(*surveyed, NodeConfiguration::Purpose::survey, std::move(questions));
}

/// A survey's question waits for all other conversations to begin, and for the end of a
/// conversation with its robot.
std::optional<TimePoint> NodeConversations::survey_due() const {
  return conversations_.contains(survey_.address()) ? std::nullopt : survey_.due();
}

/// The key refresh comes first: a node that has missed a step may not understand the rest.
NodeConfiguration::Purpose NodeConversations::purpose_for(const Node& node) const {
  if (refresh_.is_due(node)) return NodeConfiguration::Purpose::refresh;
  return is_only_moved(node) ? NodeConfiguration::Purpose::move
                             : NodeConfiguration::Purpose::configure;
}

std::optional<NodeConfiguration::Purpose> NodeConversations::ordered_purpose() const {
  if (order_.is(OpenOrder::Kind::remove)) return NodeConfiguration::Purpose::reset;
  if (order_.is(OpenOrder::Kind::ping)) return NodeConfiguration::Purpose::ping;
  if (order_.is(OpenOrder::Kind::config)) return NodeConfiguration::Purpose::inquire;
  return std::nullopt;
}

/// Returns the node of an operator's order when its conversation may begin, else null. A node gets
/// changed settings before it is asked for its configuration.
const Node* NodeConversations::ordered_node() const {
  if (!ordered_purpose()) return nullptr;
  const Node* node = nodes_.find(order_->uuid);
  if (node == nullptr || is_talking_with(*node)) return nullptr;
  return order_.is(OpenOrder::Kind::config) && is_outdated(*node) ? nullptr : node;
}

/// Returns the next node, or null. Nodes that miss a step of the key refresh come first, then those
/// that were heard, then those that wait longest. So a node that is switched off does not hold up
/// others.
const Node* NodeConversations::next_node(TimePoint now) {
  const Node* next = nullptr;
  std::tuple<bool, bool, TimePoint> next_turn;
  for (const Node& node : nodes_.database()->nodes) {
    const NodeHistory& history = nodes_.history(node.uuid);
    if (!needs_configuration(node) || history.retry_at > now) continue;
    const std::tuple turn{!refresh_.is_due(node), !history.heard_at && !history.joined_at,
                          history.retry_at};
    if (next == nullptr || turn < next_turn) {
      next = &node;
      next_turn = turn;
    }
  }
  return next;
}

std::optional<TimePoint> NodeConversations::next_begin() const {
  if (!link_.is_up || !nodes_.database() || !nodes_.is_saved()) return std::nullopt;
  if (conversations_.size() >= max_conversations) return std::nullopt;
  if (wants_restart_) return std::nullopt;
  if (ordered_node() != nullptr) return TimePoint::min();
  std::optional<TimePoint> next;
  for (const Node& node : nodes_.database()->nodes) {
    if (!needs_configuration(node)) continue;
    const NodeHistory* history = nodes_.find_history(node.uuid);
    next = earlier(next, history ? history->retry_at : TimePoint::min());
  }
  return earlier(next, survey_due());
}

std::optional<TimePoint> NodeConversations::deadline() const {
  std::optional<TimePoint> next = next_begin();
  for (const auto& [address, conversation] : conversations_)
    next = earlier(next, conversation.deadline());
  return next;
}

// --- Results -------------------------------------------------------------------------------------

void NodeConversations::continue_all(TimePoint now) {
  for (auto next = conversations_.begin(); next != conversations_.end();) {
    const auto found = next++;
    NodeConfiguration& conversation = found->second;
    conversation.on_deadline(now);
    conversation.send_due(now);
    if (conversation.state() == NodeConfiguration::State::running) continue;
    const NodeConfiguration ended = std::move(conversation);
    conversations_.erase(found);
    end(ended, now);
  }
}

void NodeConversations::end(const NodeConfiguration& conversation, TimePoint now) {
  if (conversation.purpose() == NodeConfiguration::Purpose::survey)
    return survey_.on_asked(conversation, now);  // whether the node is still there or not
  const Node* node = nodes_.find(conversation.address());
  if (node == nullptr) return;
  const bool is_done = conversation.state() == NodeConfiguration::State::succeeded;
  switch (conversation.purpose()) {
    case NodeConfiguration::Purpose::reset:
      return on_reset(*node, is_done, conversation.problem(), now);
    case NodeConfiguration::Purpose::refresh: return on_refreshed(*node, conversation, now);
    case NodeConfiguration::Purpose::ping:
    case NodeConfiguration::Purpose::inquire: return on_asked(*node, conversation);
    case NodeConfiguration::Purpose::survey:
    case NodeConfiguration::Purpose::configure:
    case NodeConfiguration::Purpose::move: break;
  }
  if (is_done && conversation.problem().empty())
    return on_configured(*node, conversation.settings());
  on_not_configured(*node, conversation.problem(), now);
}

void NodeConversations::on_asked(const Node& node, const NodeConfiguration& conversation) {
  const std::string id = nodes_.id_of(node.address);
  if (order_.is(OpenOrder::Kind::ping, node.uuid))
    return order_.answer(ping_json(id, conversation));
  if (!order_.is(OpenOrder::Kind::config, node.uuid)) return;  // the link has been down
  if (conversation.state() == NodeConfiguration::State::failed)
    return order_.refuse(fmt::format("{}: {}", id, conversation.problem()));
  order_.answer(node_config_json(id, node, conversation,
                                 [this](std::uint16_t address) { return hears(address); }));
}

/// Returns true for the gateway's groups, and for the addresses of its radio's lives.
bool NodeConversations::hears(std::uint16_t address) const {
  const auto& groups = settings_.groups;
  return std::ranges::find(groups, address) != groups.end() || address == destination() ||
         (radio_.hears_earlier_lives() && address >= settings_.address && address <= link_.source);
}

void NodeConversations::on_refreshed(const Node& node, const NodeConfiguration& conversation,
                                     TimePoint now) {
  if (conversation.state() == NodeConfiguration::State::succeeded)
    return refresh_.on_taken(node.uuid, conversation.settings().refresh.step);
  const std::string id = nodes_.id_of(node.address);
  notify(
      Severity::warning,
      id + " has not completed the key refresh yet: " + put_off(node, conversation.problem(), now),
      id);
}

/// Puts off the next attempt. Returns the problem and the pause in words.
std::string NodeConversations::put_off(const Node& node, const std::string& problem,
                                       TimePoint now) {
  NodeHistory& history = nodes_.history(node.uuid);
  const Duration pause = pause_after(++history.failures);
  history.retry_at = now + pause;
  history.problem = problem;
  return fmt::format("{}; the next attempt is in {} s", problem,
                     std::chrono::duration_cast<std::chrono::seconds>(pause).count());
}

void NodeConversations::drop(std::uint16_t address) {
  if (conversations_.erase(address) == 1) radio_.forget_device_key(address);
}

void NodeConversations::on_configured(const Node& known, const ConfigurationSettings& sent) {
  Node& node = *nodes_.change().find(known.uuid);
  const Node before = node;
  node.state = NodeState::configured;
  node.ttl = sent.ttl;
  // Wishes that came during the conversation are sent in the next one.
  node.applied =
      AppliedSettings{sent.destination, sent.groups, node.wishes != sent.wishes, sent.relay_group};
  nodes_.history(node.uuid).forget_failures();
  nodes_.announce_change();
  const std::string id = nodes_.id_of(node.address);
  if (is_outdated(before))
    return notify(Severity::notice,
                  fmt::format("{} is reconfigured: {}", id, changes_from(before, sent)), id);
  admission_.permit().on_configured(node.uuid, id);
  notify(Severity::notice, fmt::format("{} is configured", id), id);
  if (order_.is(OpenOrder::Kind::provision, node.uuid)) order_.answer(nodes_.json(node));
}

std::string NodeConversations::changes_from(const Node& before, const ConfigurationSettings& sent) {
  std::vector<std::string> changes;
  if (before.applied->destination != sent.destination)
    changes.push_back(fmt::format("it publishes to 0x{:04x}", sent.destination));
  if (before.ttl != sent.ttl) changes.push_back(fmt::format("its TTL is {}", sent.ttl));
  if (!std::ranges::is_permutation(before.applied->groups, sent.groups))
    changes.push_back(sent.groups.empty()
                          ? "it has no groups"
                          : fmt::format("its groups are 0x{:04x}", fmt::join(sent.groups, ", 0x")));
  if (before.applied->relay_group != sent.relay_group)
    changes.push_back(sent.relay_group
                          ? fmt::format("it hears relayed updates in 0x{:04x}", *sent.relay_group)
                          : "it hears no relayed updates");
  if (changes.empty()) return "all its settings were sent again";
  return fmt::format("{}", fmt::join(changes, "; "));
}

bool NodeConversations::may_be_unheard(const Node& node) const {
  const NodeDatabase& database = *nodes_.database();
  std::size_t sources = 0;
  for (const Node& each : database.nodes) sources += each.elements;
  for (const RemovedNode& each : database.removed) sources += each.elements;
  return sources > radio_.max_senders() || was_used_before(database, node.address, node.elements);
}

void NodeConversations::on_not_configured(const Node& node, const std::string& problem,
                                          TimePoint now) {
  const std::string words = put_off(node, problem, now);
  NodeHistory& history = nodes_.history(node.uuid);
  if (!history.has_restarted_radio && history.joined_at && !history.heard_at &&
      may_be_unheard(node))
    history.has_restarted_radio = wants_restart_ = true;
  admission_.permit().on_failed(node.uuid, problem);
  const std::string id = nodes_.id_of(node.address);
  const bool has_old = node.state == NodeState::configured;
  notify(
      Severity::warning,
      fmt::format("{} {}: {}", id,
                  has_old ? "still has its old configuration" : "is in the mesh but not configured",
                  words),
      id);
  if (!has_old && order_.is(OpenOrder::Kind::provision, node.uuid))
    order_.answer(nodes_.json(node));
  if (has_old && order_.is(OpenOrder::Kind::config, node.uuid))
    order_.refuse(fmt::format("{}: {}; the new settings are kept and tried again", id, problem));
}

void NodeConversations::on_reset(const Node& node, bool is_done, const std::string& problem,
                                 TimePoint now) {
  const bool is_ordered = order_.is(OpenOrder::Kind::remove, node.uuid);
  const std::string id = nodes_.id_of(node.address);
  nodes_.history(node.uuid).retry_at = now;
  if (!is_done && !(is_ordered && order_->is_forced)) {
    if (is_ordered)
      order_.refuse(
          fmt::format("{} is still in the mesh: {}; bring it in reach, or forget it with "
                      "--force",
                      id, problem));
    return;
  }
  std::string json = nodes_.json(node);
  const bool was_reset = is_done && node.state != NodeState::reserved;
  json.insert(json.size() - 1, fmt::format(R"(,"was_reset":{})", was_reset));
  admission_.remove(node.uuid);
  notify(Severity::notice, fmt::format("{} was removed from the mesh", id), id);
  if (is_ordered) order_->removed = std::move(json);
}

}  // namespace slamgw::ble
