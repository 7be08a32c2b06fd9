// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/key_refresh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw::ble {

RefreshStep KeyRefresh::step() const {
  const NodeDatabase* database = nodes_.database();
  return database && database->refresh ? database->refresh->step : RefreshStep::none;
}

void KeyRefresh::begin(const MeshKeys& keys) {
  nodes_.change().refresh = RefreshState{RefreshStep::distributing, keys};
  begin_step(RefreshStep::distributing);
}

// --- The nodes -----------------------------------------------------------------------------------

bool KeyRefresh::is_missing(const Node& node) const {
  return is_on() && node.state != NodeState::reserved && node.refreshed < step();
}

bool KeyRefresh::is_due(const Node& node) const {
  return is_missing(node) && node.state == NodeState::configured;
}

std::size_t KeyRefresh::missing() const {
  if (!is_on()) return 0;
  const auto& nodes = nodes_.database()->nodes;
  return static_cast<std::size_t>(
      std::ranges::count_if(nodes, [&](const Node& node) { return is_missing(node); }));
}

bool KeyRefresh::has_failed(const Node& node) const {
  const NodeHistory* history = nodes_.find_history(node.uuid);
  return is_missing(node) && history != nullptr && history->failures > 0;
}

void KeyRefresh::on_taken(const Uuid& uuid, RefreshStep step) {
  if (!is_on()) return;
  Node& node = *nodes_.change().find(uuid);
  node.refreshed = std::max(node.refreshed, step);
  nodes_.history(uuid).forget_failures();
}

// --- The steps -----------------------------------------------------------------------------------

/// The radio changes its keys when the disk has the step. So the radio hears both keys before a
/// node sends under the new one. It sends under the new one when all nodes hear the new one.
void KeyRefresh::advance(bool may_join, TimePoint now) {
  if (!is_on() || !nodes_.is_saved()) return;
  const bool is_told = std::exchange(radio_step_, step()) == step();
  if (!is_told && step() != RefreshStep::distributing)
    radio_.change_keys(radio_keys(*nodes_.database()), now);
  if (!is_told || !link_.is_up || !is_step_done(may_join)) return;
  switch (step()) {
    case RefreshStep::none: return;
    case RefreshStep::distributing: return begin_step(RefreshStep::switching);
    case RefreshStep::switching: return begin_step(RefreshStep::finishing);
    case RefreshStep::finishing: return end();
  }
}

/// The first step waits for each robot: without the new keys a robot would hear nothing afterwards.
/// The second step waits for one attempt, because a silent robot hears the new key already. The
/// last step ends when all have answered.
bool KeyRefresh::is_step_done(bool may_join) const {
  if (step() == RefreshStep::switching)
    return std::ranges::none_of(nodes_.database()->nodes, [&](const Node& node) {
      return is_missing(node) && !has_failed(node);
    });
  const bool is_ready = step() == RefreshStep::finishing ? has_switched_ : !may_join;
  return is_ready && missing() == 0;
}

void KeyRefresh::begin_step(RefreshStep step) {
  NodeDatabase& database = nodes_.change();
  if (step == RefreshStep::finishing) std::swap(database.keys, database.refresh->other);
  database.refresh->step = step;
  has_switched_ = false;
  for (const Node& node : database.nodes) {
    NodeHistory& history = nodes_.history(node.uuid);
    history.forget_failures();
    history.retry_at = TimePoint::min();
  }
  notify(Severity::notice, step == RefreshStep::distributing
                               ? "a refresh of the mesh's keys begins: robots get new ones"
                           : step == RefreshStep::switching
                               ? "all robots have the mesh's new keys and switch to them"
                               : "the gateway switches to the mesh's new keys, and "
                                 "robots forget the old ones");
}

void KeyRefresh::end() {
  NodeDatabase& database = nodes_.change();
  database.refresh.reset();
  for (Node& node : database.nodes) node.refreshed = RefreshStep::none;
  radio_step_ = RefreshStep::none;
  notify(Severity::notice,
         fmt::format("the mesh's keys are refreshed: {} robots have the new ones; earlier backups "
                     "hold the old ones, make another",
                     database.nodes.size()));
}

std::string KeyRefresh::json() const {
  nlohmann::ordered_json missing = nlohmann::ordered_json::array();
  std::size_t robots = 0;
  for (const Node& node : nodes_.database()->nodes) {
    robots += node.state == NodeState::reserved ? 0 : 1;
    if (!is_missing(node)) continue;
    const NodeHistory* history = nodes_.find_history(node.uuid);
    missing.push_back({{"robot", nodes_.id_of(node.address)},
                       {"has_new_keys", node.refreshed != RefreshStep::none},
                       {"problem", history ? history->problem : ""}});
  }
  return nlohmann::ordered_json{{"step", to_string(step())},
                                {"robots", robots},
                                {"refreshed", robots - missing.size()},
                                {"missing", std::move(missing)}}
      .dump();
}

}  // namespace slamgw::ble
