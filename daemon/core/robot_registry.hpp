// SPDX-License-Identifier: Apache-2.0
// What is known about each robot: where it is, when it was last heard, how much it says. Values
// only; the gateway decides what to publish from it.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "daemon/core/burst.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/robot_numbers.hpp"

namespace slamgw {

/// One robot's life on one mesh.
struct MeshPresence {
  bool is_known = false;
  Presence presence = Presence::offline;
  std::string address;
  WallTime since{};
};

struct Robot {
  PerMesh<MeshPresence> on_mesh;
  Mesh last_mesh = Mesh::thread;  ///< where it last came, went or spoke
  WallTime last_seen{};
  RobotNumbers numbers;
  TimePoint announced{};            ///< its presence was published last
  std::optional<RadioFacts> radio;  ///< of its last message
  Burst rejected_burst;

  /// The mesh that speaks for it: one where it is online, else asleep, else the last one.
  Mesh mesh() const;
  const MeshPresence& presence() const { return on_mesh[mesh()]; }
};

class RobotRegistry {
 public:
  /// A robot beyond this many is not tracked (its messages still pass); twice the default of
  /// `mqttsn.max_clients`.
  static constexpr std::size_t max_robots = 20000;

  /// The robot after the change; nothing when there is no room for it.
  Robot* on_presence(const PresenceChange& change, const Now& now);
  Robot* on_report(const Report& report, const Now& now);
  /// These are of robots that are known already; null otherwise.
  Robot* on_sign_of_life(const std::string& robot, const Now& now);
  Robot* find(const std::string& robot);

  const Robot* find(const std::string& robot) const;
  /// Empty when it was never there.
  std::string address_of(const std::string& robot, Mesh mesh) const;
  const std::map<std::string, Robot>& robots() const { return robots_; }
  std::map<std::string, Robot>& robots() { return robots_; }
  /// How many robots are online, asleep, offline (all meshes considered).
  std::size_t count(Presence presence) const { return counts_[static_cast<std::size_t>(presence)]; }
  std::uint64_t untracked() const { return untracked_; }

 private:
  Robot* find_or_add(const std::string& robot);

  std::map<std::string, Robot> robots_;
  std::array<std::size_t, 3> counts_{};  // by Presence
  std::uint64_t untracked_ = 0;
};

}  // namespace slamgw
