// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/subscription_table.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {
namespace {

constexpr SubscriptionId largest_id = 268435455;  // MQTT 5: a variable byte integer

std::size_t index_of(Mesh mesh) { return static_cast<std::size_t>(mesh); }

std::vector<Mesh> take_waiting(SubscriptionTable::Wanted& wanted) {
  std::vector<Mesh> meshes;
  for (const Mesh mesh : {Mesh::ble, Mesh::thread}) {
    meshes.insert(meshes.end(), std::exchange(wanted.waiting[index_of(mesh)], 0u), mesh);
  }
  return meshes;
}

}  // namespace

const SubscriptionTable::Wanted& SubscriptionTable::add(Mesh mesh, const std::string& filter,
                                                        Qos qos) {
  Wanted& wanted = wanted_[filter];
  if (wanted.id == 0) wanted.id = last_id_ = last_id_ % largest_id + 1;
  wanted.by_mesh[index_of(mesh)] = true;
  wanted.qos = std::max(wanted.qos, qos);
  return wanted;
}

bool SubscriptionTable::remove(Mesh mesh, const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return false;
  known->second.by_mesh[index_of(mesh)] = false;
  if (known->second.by_mesh[0] || known->second.by_mesh[1]) return false;
  forget(known);
  return true;
}

void SubscriptionTable::forget(std::map<std::string, Wanted>::iterator wanted) {
  standing_.erase(wanted->first);
  wanted_.erase(wanted);
}

void SubscriptionTable::await(Mesh mesh, const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known != wanted_.end()) ++known->second.waiting[index_of(mesh)];
}

std::vector<Mesh> SubscriptionTable::on_answer(const std::string& filter, bool granted) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return {};  // not wanted any more
  std::vector<Mesh> meshes = take_waiting(known->second);
  if (granted) {
    standing_[filter] = known->second.id;
  } else {
    forget(known);
  }
  return meshes;
}

std::vector<SubscriptionTable::Waiting> SubscriptionTable::on_broker_gone() {
  standing_.clear();
  std::vector<Waiting> waiting;
  for (auto& [filter, wanted] : wanted_) {
    for (const Mesh mesh : take_waiting(wanted)) waiting.push_back({mesh, filter});
  }
  return waiting;
}

bool SubscriptionTable::is_copy_to_take(std::string_view topic,
                                        std::span<const SubscriptionId> ids) const {
  if (ids.empty()) return true;
  SubscriptionId lowest = 0;
  standing_.match(topic, [&](SubscriptionId id) {
    if (lowest == 0 || id < lowest) lowest = id;
  });
  // No subscription stands yet when the message has overtaken its SUBACK.
  return lowest == 0 || std::find(ids.begin(), ids.end(), lowest) != ids.end();
}

}  // namespace slamgw
