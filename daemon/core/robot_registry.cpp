// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_registry.hpp"

#include <algorithm>

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
  if (robots_.size() >= max_robots) {
    ++untracked_;
    return nullptr;
  }
  ++counts_[static_cast<std::size_t>(Presence::offline)];
  return &robots_[robot];
}

Robot* RobotRegistry::on_presence(const PresenceChange& change, const Now& now) {
  Robot* robot = find_or_add(change.robot);
  if (!robot) return nullptr;
  --counts_[static_cast<std::size_t>(robot->presence().presence)];
  MeshPresence& there = robot->on_mesh[change.mesh];
  there = {true, change.presence, change.address, now.wall};
  robot->last_mesh = change.mesh;
  ++counts_[static_cast<std::size_t>(robot->presence().presence)];
  if (change.presence != Presence::offline) robot->last_seen = now.wall;
  return robot;
}

Robot* RobotRegistry::on_report(const Report& report, const Now& now) {
  Robot* robot = find_or_add(report.robot);
  if (!robot) return nullptr;
  if (report.is_will) return robot;
  robot->numbers.on_up(report.payload.size(), now.mono);
  robot->last_seen = now.wall;
  robot->last_mesh = report.mesh;
  robot->radio = report.radio;
  return robot;
}

Robot* RobotRegistry::on_sign_of_life(const std::string& robot, const Now& now) {
  Robot* known = find(robot);
  if (known) known->last_seen = now.wall;
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

std::string RobotRegistry::address_of(const std::string& robot, Mesh mesh) const {
  const Robot* known = find(robot);
  return known ? known->on_mesh[mesh].address : std::string();
}

}  // namespace slamgw
