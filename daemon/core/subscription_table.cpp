// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/subscription_table.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {
namespace {

std::size_t index_of(Mesh mesh) { return static_cast<std::size_t>(mesh); }

void collect(SubscriptionTable::Wanted& wanted, std::vector<Mesh>& meshes) {
  for (const Mesh mesh : {Mesh::ble, Mesh::thread}) {
    meshes.insert(meshes.end(), std::exchange(wanted.waiting[index_of(mesh)], 0u), mesh);
  }
}

}  // namespace

Qos SubscriptionTable::add(Mesh mesh, const std::string& filter, Qos qos) {
  Wanted& wanted = wanted_[filter];
  wanted.by_mesh[index_of(mesh)] = true;
  wanted.qos = std::max(wanted.qos, qos);
  return wanted.qos;
}

bool SubscriptionTable::remove(Mesh mesh, const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known == wanted_.end()) return false;
  known->second.by_mesh[index_of(mesh)] = false;
  if (known->second.by_mesh[0] || known->second.by_mesh[1]) return false;
  wanted_.erase(known);
  return true;
}

void SubscriptionTable::await(Mesh mesh, const std::string& filter) {
  const auto known = wanted_.find(filter);
  if (known != wanted_.end()) ++known->second.waiting[index_of(mesh)];
}

std::vector<Mesh> SubscriptionTable::answered(const std::string& filter) {
  std::vector<Mesh> meshes;
  const auto known = wanted_.find(filter);
  if (known != wanted_.end()) collect(known->second, meshes);
  return meshes;
}

std::vector<SubscriptionTable::Waiting> SubscriptionTable::stop_waiting() {
  std::vector<Waiting> waiting;
  for (auto& [filter, wanted] : wanted_) {
    std::vector<Mesh> meshes;
    collect(wanted, meshes);
    for (const Mesh mesh : meshes) waiting.push_back({mesh, filter});
  }
  return waiting;
}

}  // namespace slamgw
