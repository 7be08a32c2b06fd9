// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_registry.hpp"

#include <algorithm>
#include <functional>

namespace slamgw {

Mesh Robot::mesh() const {
  for (const Presence wanted : {Presence::online, Presence::asleep}) {
    const auto is_there = [&](Mesh mesh) {
      return on_mesh[mesh].is_known && on_mesh[mesh].presence == wanted;
    };
    if (is_there(last_mesh)) return last_mesh;
    const auto other = std::ranges::find_if(all_meshes, is_there);
    if (other != all_meshes.end()) return *other;
  }
  return last_mesh;
}

Robot* RobotRegistry::find_or_add(const std::string& robot) {
  const auto known = robots_.find(robot);
  if (known != robots_.end()) return &known->second;
  if (robots_.size() >= capacity_) make_room();
  if (robots_.size() >= capacity_) {
    ++untracked_;
    return nullptr;
  }
  return &robots_[robot];
}

/// Evicts many robots at once, because the search looks at every robot.
void RobotRegistry::make_room() {
  std::vector<std::map<std::string, Robot>::iterator> candidates;
  for (auto robot = robots_.begin(); robot != robots_.end(); ++robot)
    if (!is_configured(robot->first)) candidates.push_back(robot);
  const std::size_t count = std::min(
      candidates.size(), std::max<std::size_t>(1, std::min(evicted_at_once, capacity_ / 16)));
  const auto heard_for = [](const auto& robot) {
    return robot->second.last_heard - robot->second.first_heard;
  };
  std::ranges::nth_element(candidates, candidates.begin() + static_cast<std::ptrdiff_t>(count),
                           std::ranges::less(), heard_for);
  candidates.resize(count);
  for (const auto& robot : candidates) {
    evicted_.push_back(robot->first);
    robots_.erase(robot);
  }
}

void Robot::on_heard(Mesh mesh, const Now& now) {
  on_mesh[mesh].last_heard = now.mono;
  if (first_heard == TimePoint{}) first_heard = now.mono;
  last_heard = now.mono;
  last_seen = now.wall;
}

Robot* RobotRegistry::on_presence(const PresenceChange& change, const Now& now) {
  Robot* robot = find_or_add(change.robot);
  if (!robot) return nullptr;
  MeshPresence& there = robot->on_mesh[change.mesh];
  const bool is_same_state = there.is_known && there.presence == change.presence;
  there.is_known = true;
  there.presence = change.presence;
  // A client whose address another one took has none: it is shown where it was last.
  if (!change.address.empty()) there.address = change.address;
  if (!is_same_state) there.since = now.wall;
  there.is_deaf = change.is_deaf;
  there.is_contested = change.is_contested;
  robot->last_mesh = change.mesh;
  if (change.presence != Presence::offline) robot->on_heard(change.mesh, now);
  return robot;
}

/// A message of QoS -1 outside robots' topics has no robot.
Robot* RobotRegistry::on_report(const Report& report, const Now& now) {
  Robot* robot = report.robot.empty() ? nullptr : find_or_add(report.robot);
  if (!robot) return nullptr;
  if (report.is_will) return robot;
  robot->numbers.on_up(report.payload.size(), now.mono);
  robot->on_heard(report.mesh, now);
  ++robot->on_mesh[report.mesh].up;
  robot->on_mesh[report.mesh].radio = report.radio;
  robot->last_mesh = report.mesh;
  return robot;
}

Robot* RobotRegistry::on_sign_of_life(const std::string& robot, Mesh mesh, const Now& now) {
  Robot* known = find(robot);
  if (known) known->on_heard(mesh, now);
  return known;
}

Robot* RobotRegistry::find(const std::string& robot) {
  const auto known = robots_.find(robot);
  return known != robots_.end() ? &known->second : nullptr;
}

const Robot* RobotRegistry::find(const std::string& robot) const {
  const auto known = robots_.find(robot);
  return known != robots_.end() ? &known->second : nullptr;
}

std::size_t RobotRegistry::count(Presence presence) const {
  return static_cast<std::size_t>(std::ranges::count_if(
      robots_, [&](const auto& entry) { return entry.second.presence().presence == presence; }));
}

std::size_t RobotRegistry::deaf() const {
  return static_cast<std::size_t>(std::ranges::count_if(
      robots_, [](const auto& entry) { return entry.second.presence().is_deaf; }));
}

std::size_t RobotRegistry::contested() const {
  return static_cast<std::size_t>(std::ranges::count_if(
      robots_, [](const auto& entry) { return entry.second.is_contested(); }));
}

std::string RobotRegistry::address_of(const std::string& robot, Mesh mesh) const {
  const Robot* known = find(robot);
  return known ? known->on_mesh[mesh].address : std::string();
}

}  // namespace slamgw
