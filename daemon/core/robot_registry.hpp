// SPDX-License-Identifier: Apache-2.0
// What is known about each robot: where it is, when it was last heard, how much it says. Values
// only; the gateway decides what to publish from it.
#pragma once

#include <array>
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
  bool is_deaf = false;  ///< it does not hear the gateway; not a state, and `since` not its time
  bool is_contested = false;  ///< another client uses its id there
  TimePoint last_heard{};     ///< there
  std::uint64_t up = 0;       ///< its messages there
  std::uint64_t down = 0;     ///< commands to it there
  std::uint64_t repeats = 0;  ///< its messages there that came again and did not go up again

  bool was_used() const { return is_known || up + down + repeats > 0; }
};

struct Robot {
  PerMesh<MeshPresence> on_mesh;
  Mesh last_mesh = Mesh::thread;  ///< where it last came, went or spoke
  WallTime last_seen{};
  TimePoint first_heard{};
  TimePoint last_heard{};  ///< any sign of life
  RobotNumbers numbers;
  std::string last_type;             ///< of its last message; empty: it said nothing yet
  TimePoint announced{};             ///< its presence was published last
  bool is_announcement_due = false;  ///< it was not published, because the robot may be elsewhere
  std::optional<RadioFacts> radio;   ///< of its last message
  /// The broker has its document for Home Assistant: with its signal or without.
  std::optional<bool> is_described_with_signal;
  bool is_session_contested = false;  ///< another client takes its session at the broker
  LogThrottle rejected_throttle;

  void on_heard(Mesh mesh, const Now& now);
  /// The mesh that speaks for it: one where it is online, else asleep, else the last one.
  Mesh mesh() const;
  const MeshPresence& presence() const { return on_mesh[mesh()]; }
  bool is_contested() const { return is_session_contested || presence().is_contested; }
};

class RobotRegistry {
 public:
  /// Twice the default of `mqttsn.max_clients`. When it is reached, `evicted_at_once` robots are
  /// evicted: those that are not configured and were heard over the shortest time. So a crowd of
  /// strangers evicts only strangers.
  static constexpr std::size_t max_robots = 20000;
  static constexpr std::size_t evicted_at_once = 1000;

  explicit RobotRegistry(std::size_t capacity = max_robots) : capacity_(capacity) {}

  /// Robots of the configuration are never evicted. When they alone fill the capacity, other robots
  /// are not tracked (their messages still pass).
  void set_configured(std::set<std::string> robots) { configured_ = std::move(robots); }
  bool is_configured(const std::string& robot) const { return configured_.contains(robot); }
  const std::set<std::string>& configured() const { return configured_; }

  /// The robot after the change; nothing when there is no room for it.
  Robot* on_presence(const PresenceChange& change, const Now& now);
  Robot* on_report(const Report& report, const Now& now);
  /// False when it is not known.
  bool forget(const std::string& robot);
  /// Robots that had to make room since the last call.
  std::vector<std::string> take_evicted() { return std::exchange(evicted_, {}); }
  /// These are of robots that are known already; null otherwise.
  Robot* on_sign_of_life(const std::string& robot, Mesh mesh, const Now& now);
  Robot* find(const std::string& robot);
  const Robot* find(const std::string& robot) const;
  /// Empty when it was never there.
  std::string address_of(const std::string& robot, Mesh mesh) const;
  const std::map<std::string, Robot>& robots() const { return robots_; }
  std::map<std::string, Robot>& robots() { return robots_; }
  /// How many robots are online, asleep, offline (all meshes considered).
  std::size_t count(Presence presence) const { return counts_[static_cast<std::size_t>(presence)]; }
  /// How many do not hear the gateway.
  std::size_t deaf() const;
  std::size_t contested() const;
  std::uint64_t untracked() const { return untracked_; }

 private:
  void make_room();
  void remove(std::map<std::string, Robot>::iterator robot);
  Robot* find_or_add(const std::string& robot);

  std::size_t capacity_;
  std::map<std::string, Robot> robots_;
  std::set<std::string> configured_;
  std::vector<std::string> evicted_;
  std::array<std::size_t, 3> counts_{};  // by Presence
  std::uint64_t untracked_ = 0;
};

}  // namespace slamgw
