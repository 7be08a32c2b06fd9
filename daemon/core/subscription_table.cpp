// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/subscription_table.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

namespace slamgw {
namespace {

// MQTT 5: a variable byte integer, of which the largest is taken.
constexpr SubscriptionId largest_id = own_subscription - 1;

std::vector<Mesh> take_waiting(SubscriptionTable::Wanted& wanted) {
  std::vector<Mesh> meshes;
  for (const Mesh mesh : all_meshes)
    meshes.insert(meshes.end(), std::exchange(wanted.waiting[mesh], 0u), mesh);
  return meshes;
}

}  // namespace

SubscriptionTable::Wanted& SubscriptionTable::row(const std::string& filter) {
  Wanted& wanted = wanted_[filter];
  if (wanted.id == 0) wanted.id = take_id(filter);
  return wanted;
}

void SubscriptionTable::set_qos(Wanted& wanted) const {
  wanted.qos = wanted.is_own ? std::max(wanted.mesh_qos, own_qos_) : wanted.mesh_qos;
}

const SubscriptionTable::Wanted& SubscriptionTable::add(Mesh mesh, const std::string& filter,
                                                        Qos qos, bool wants_retained) {
  const bool is_new = !wanted_.contains(filter);
  Wanted& wanted = row(filter);
  wanted.mesh_qos = std::max(wanted.mesh_qos, qos);
  set_qos(wanted);
  if (is_new) wanted.is_covered = !wants_retained;
  wanted.by_mesh[mesh] = true;
  wanted.wants_retained = wanted.wants_retained || wants_retained;
  return wanted;
}

const SubscriptionTable::Wanted& SubscriptionTable::add_own(const std::string& filter) {
  Wanted& wanted = row(filter);
  wanted.is_own = wanted.wants_retained = true;
  set_qos(wanted);
  return wanted;
}

bool SubscriptionTable::remove(Mesh mesh, const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return false;
  known->second.by_mesh[mesh] = false;
  return forget_if_unwanted(known);
}

bool SubscriptionTable::remove_own(const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return true;
  known->second.is_own = false;
  set_qos(known->second);
  return forget_if_unwanted(known);
}

bool SubscriptionTable::forget_if_unwanted(std::map<std::string, Wanted>::iterator wanted) {
  const PerMesh<bool>& by_mesh = wanted->second.by_mesh;
  if (wanted->second.is_own || std::ranges::find(by_mesh, true) != by_mesh.end()) return false;
  forget(wanted);
  return true;
}

void SubscriptionTable::forget(std::map<std::string, Wanted>::iterator wanted) {
  standing_.erase(wanted->first);
  used_ids_.erase(std::ranges::lower_bound(used_ids_, wanted->second.id));
  wanted_.erase(wanted);
}

void SubscriptionTable::set_cover(const std::string& filter, bool is_covered) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return;
  known->second.is_covered = is_covered;
  if (is_covered) standing_.erase(filter);
}

void SubscriptionTable::on_connection_changed(bool is_session_kept) {
  standing_.clear();
  sends_copies_.reset();
  own_qos_ = is_session_kept ? Qos::at_least_once : Qos::at_most_once;
  for (auto& [filter, wanted] : wanted_) {
    wanted.is_covered = !wanted.wants_retained;
    set_qos(wanted);
  }
}

std::vector<std::string> SubscriptionTable::set_cover(
    const std::function<bool(const std::string& filter, const Wanted& wanted)>& is_covered) {
  std::vector<std::string> changed;
  for (auto& [filter, wanted] : wanted_) {
    const bool before = wanted.is_covered;
    wanted.is_covered = is_covered(filter, wanted);
    if (before == wanted.is_covered) continue;
    standing_.erase(filter);
    changed.push_back(filter);
  }
  return changed;
}

std::vector<std::string> SubscriptionTable::covered() const {
  std::vector<std::string> filters;
  for (const auto& [filter, wanted] : wanted_)
    if (wanted.is_covered) filters.push_back(filter);
  return filters;
}

void SubscriptionTable::await(Mesh mesh, const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known != wanted_.end()) ++known->second.waiting[mesh];
}

std::vector<Mesh> SubscriptionTable::on_answer(const std::string& filter, bool granted) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return {};  // not wanted any more
  std::vector<Mesh> meshes = take_waiting(known->second);
  if (granted && known->second.is_covered) return meshes;
  if (granted) {
    standing_[filter] = {known->second.id, known->second.qos, known->second.is_own};
    return meshes;
  }
  for (const Mesh mesh : all_meshes) {
    const bool is_named = std::ranges::find(meshes, mesh) != meshes.end();
    if (known->second.by_mesh[mesh] && !is_named) meshes.push_back(mesh);
  }
  forget(known);
  return meshes;
}

std::vector<SubscriptionTable::Waiting> SubscriptionTable::take_all_waiting() {
  std::vector<Waiting> waiting;
  for (auto& [filter, wanted] : wanted_) {
    for (const Mesh mesh : take_waiting(wanted)) waiting.push_back({mesh, filter});
  }
  return waiting;
}

bool SubscriptionTable::is_only_of(const std::string& filter, const std::string& topic) const {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return false;
  bool is_only = true;
  standing_.match(topic, [&](const StandingSubscription& standing) {
    is_only = is_only && standing.id == known->second.id;
  });
  return is_only;
}

/// From the filter (FNV-1a): messages that the broker kept for us while we restarted come with the
/// id that their subscription had then.
SubscriptionId SubscriptionTable::make_id(std::string_view filter) const {
  std::uint32_t hash = 2166136261U;
  for (const char c : filter) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619U;
  SubscriptionId id = hash % largest_id + 1;
  while (std::ranges::binary_search(used_ids_, id)) id = id % largest_id + 1;
  return id;
}

SubscriptionId SubscriptionTable::take_id(std::string_view filter) {
  const SubscriptionId id = make_id(filter);
  used_ids_.insert(std::ranges::lower_bound(used_ids_, id), id);
  return id;
}

bool SubscriptionTable::is_copy_to_take(const BrokerMessage& message,
                                        std::span<const SubscriptionId> ids) {
  StandingSubscription best;
  std::size_t copies = 0;
  standing_.match(message.topic, [&](const StandingSubscription& standing) {
    const auto rank = [](const StandingSubscription& each) {
      return std::tuple(each.qos, each.is_own, -std::int64_t{each.id});
    };
    if (best.id == 0 || rank(standing) > rank(best)) best = standing;
    ++copies;
  });
  if (ids.empty())
    return copies < 2 || !sends_copies_.value_or(true) || is_first_in_row(message, copies);
  if (is_copy_of_last(message, ids)) return false;
  ids_of_last_.clear();
  if (best.id != 0) return std::ranges::find(ids, best.id) != ids.end();
  repeated_ = message;
  ids_of_last_.assign(ids.begin(), ids.end());
  return true;
}

/// Copies of one message name different subscriptions; an equal message names the same again.
bool SubscriptionTable::is_copy_of_last(const BrokerMessage& message,
                                        std::span<const SubscriptionId> ids) {
  const bool is_equal = !ids_of_last_.empty() && message.topic == repeated_.topic &&
                        message.payload == repeated_.payload;
  if (!is_equal || std::ranges::find_first_of(ids_of_last_, ids) != ids_of_last_.end())
    return false;
  ids_of_last_.insert(ids_of_last_.end(), ids.begin(), ids.end());
  return true;
}

/// Copies may differ in QoS: each comes at that of its subscription.
bool SubscriptionTable::is_first_in_row(const BrokerMessage& message, std::size_t copies) {
  const bool is_copy = copies_to_come_ > 0 && message.topic == repeated_.topic &&
                       message.payload == repeated_.payload;
  if (is_copy) {
    --copies_to_come_;
    return false;
  }
  repeated_ = message;
  copies_to_come_ = copies - 1;
  return true;
}

}  // namespace slamgw
