// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_registry.hpp"

#include <algorithm>

namespace slamgw {
namespace {

constexpr std::chrono::seconds rate_window{5};

}  // namespace

void RateMeter::on_message(TimePoint now) {
  if (now - window_start_ >= rate_window) {
    in_previous_ = now - window_start_ < 2 * rate_window ? in_window_ : 0;
    in_window_ = 0;
    window_start_ = now;
  }
  ++in_window_;
}

double RateMeter::per_second(TimePoint now) const {
  const auto age = now - window_start_;
  if (age >= 2 * rate_window) return 0;
  const std::chrono::duration<double> covered = rate_window + age;
  return (in_previous_ + in_window_) / covered.count();
}

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
  ++robot->messages_up;
  robot->rate.on_message(now.mono);
  robot->last_seen = now.wall;
  robot->last_mesh = report.mesh;
  robot->radio = report.radio;
  return robot;
}

void RobotRegistry::on_sign_of_life(const std::string& robot, const Now& now) {
  const auto known = robots_.find(robot);
  if (known != robots_.end()) known->second.last_seen = now.wall;
}

void RobotRegistry::on_command(const std::string& robot) {
  const auto known = robots_.find(robot);
  if (known != robots_.end()) ++known->second.messages_down;
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
