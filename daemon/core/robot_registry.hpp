// SPDX-License-Identifier: Apache-2.0
// The facts known about each robot: where it is, when it was last heard, how much it sends. Values
// only; Gateway decides what to publish of them.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/robot_numbers.hpp"

namespace slamgw {

/// One robot's life on one mesh.
struct MeshPresence {
  bool is_known = false;
  Presence presence = Presence::offline;
  std::string address;
  WallTime since{};
  bool is_deaf = false;             ///< the robot does not hear the gateway
  bool is_contested = false;        ///< another client uses the robot's id there
  TimePoint last_heard{};           ///< on this mesh
  std::optional<RadioFacts> radio;  ///< of its last message there
  std::uint64_t up = 0;             ///< the robot's messages there
  std::uint64_t down = 0;           ///< commands to the robot there
  std::uint64_t repeats = 0;  ///< its messages there that came again and were not published again

  bool was_used() const { return is_known || up + down + repeats > 0; }
};

struct Robot {
  PerMesh<MeshPresence> on_mesh;
  Mesh last_mesh = Mesh::thread;  ///< the mesh of its last presence change or message
  WallTime last_seen{};
  TimePoint first_heard{};
  TimePoint last_heard{};  ///< any sign of life
  RobotNumbers numbers;
  std::string last_type;  ///< of its last message; empty before its first message
  TimePoint announced{};  ///< when its presence was last published
  bool is_announcement_due =
      false;  ///< its presence was held back, because the robot may be elsewhere
  /// Set while the broker has the robot's document for Home Assistant; true if that has a signal.
  std::optional<bool> is_described_with_signal;
  bool is_session_contested = false;  ///< another client takes its session at the broker
  LogThrottle rejected_throttle;

  void on_heard(Mesh mesh, const Now& now);
  /// Returns the mesh whose presence counts: one where the robot is online, else asleep, else the
  /// last one.
  Mesh mesh() const;
  const MeshPresence& presence() const { return on_mesh[mesh()]; }
  bool is_contested() const { return is_session_contested || presence().is_contested; }
  RadioFacts radio_now() const { return presence().radio.value_or(RadioFacts{}); }
};

class RobotRegistry {
 public:
  /// Twice the default of `mqttsn.max_clients`. When it is reached, `evicted_at_once` robots are
  /// evicted: robots that are not configured and were heard over the shortest time. So a crowd of
  /// strangers evicts only strangers.
  static constexpr std::size_t max_robots = 20000;
  static constexpr std::size_t evicted_at_once = 1000;

  explicit RobotRegistry(std::size_t capacity = max_robots) : capacity_(capacity) {}

  /// Robots of the configuration are never evicted. When they alone fill the capacity, other robots
  /// are not tracked (their messages still pass).
  void set_configured(std::set<std::string> robots) { configured_ = std::move(robots); }
  bool is_configured(const std::string& robot) const { return configured_.contains(robot); }
  const std::set<std::string>& configured() const { return configured_; }

  /// Returns the robot after the change; null when there is no room for it.
  Robot* on_presence(const PresenceChange& change, const Now& now);
  Robot* on_report(const Report& report, const Now& now);
  /// Returns false when the robot is not known.
  bool forget(const std::string& robot) { return robots_.erase(robot) > 0; }
  /// Returns the robots that were evicted since the last call.
  std::vector<std::string> take_evicted() { return std::exchange(evicted_, {}); }
  /// Null for a robot that is not known yet.
  Robot* on_sign_of_life(const std::string& robot, Mesh mesh, const Now& now);
  Robot* find(const std::string& robot);
  const Robot* find(const std::string& robot) const;
  /// Empty when the robot was never on this mesh.
  std::string address_of(const std::string& robot, Mesh mesh) const;
  const std::map<std::string, Robot>& robots() const { return robots_; }
  std::map<std::string, Robot>& robots() { return robots_; }
  /// Returns how many robots have this presence (all meshes considered).
  std::size_t count(Presence presence) const;
  /// Returns how many robots do not hear the gateway.
  std::size_t deaf() const;
  std::size_t contested() const;
  std::uint64_t untracked() const { return untracked_; }

 private:
  void make_room();
  Robot* find_or_add(const std::string& robot);

  std::size_t capacity_;
  std::map<std::string, Robot> robots_;
  std::set<std::string> configured_;
  std::vector<std::string> evicted_;
  std::uint64_t untracked_ = 0;
};

}  // namespace slamgw
