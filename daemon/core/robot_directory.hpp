// SPDX-License-Identifier: Apache-2.0
// The known robots and where they are: heard by this gateway's meshes, named or banned by the
// configuration, or shown by another gateway. Pure; Gateway, Commands and PresencePublisher share
// one.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <tuple>

#include "daemon/core/carrier_choice.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/robot_registry.hpp"

namespace slamgw {

/// The core's questions about robots that several gateways could serve (docs/fleet.md). The
/// application answers them; without an answer, this gateway serves every robot.
struct RobotPlaces {
  using Question = std::function<bool(const std::string& robot)>;
  /// This gateway holds the robot's session at the broker.
  Question is_held = [](const std::string&) { return true; };
  /// Another living gateway shows the robot as its own.
  Question is_elsewhere = [](const std::string&) { return false; };
  /// Some gateway, living or not, shows the robot.
  Question is_shown = [](const std::string&) { return false; };
  /// The broker does not give this gateway the robot's session.
  Question is_refused = [](const std::string&) { return false; };
  /// No other gateway is known.
  std::function<bool()> is_alone = [] { return true; };
  /// The robot may have a subscription to this topic; false: it is known to have none.
  std::function<bool(const std::string& robot, const std::string& topic)> may_want =
      [](const std::string&, const std::string&) { return true; };
};

/// Asks a mesh: MeshAdapter::presence_of.
using PresenceQuery = std::function<std::optional<Presence>(Mesh, const std::string& robot)>;

struct RobotDirectory {
  RobotRegistry registry;
  RobotNames names;
  RobotPlaces places;
  PresenceQuery presence_on;
  CarrierChoice choice;

  /// True when this gateway has heard the robot, or any gateway shows it.
  bool is_known(const std::string& robot) const {
    return registry.find(robot) != nullptr || places.is_shown(robot);
  }
  /// A robot that is heard on one mesh may be gone from the other long before its keep-alive time
  /// runs out there.
  static constexpr std::chrono::seconds silent_after{5};
  bool is_silent(const std::string& robot, Mesh mesh, TimePoint now) const {
    const Robot* known = registry.find(robot);
    return known != nullptr && now - known->on_mesh[mesh].last_heard > silent_after;
  }
  /// Returns the one mesh that carries a command for this robot: a mesh that reaches it, and of two
  /// such meshes the better one. Nothing when no mesh knows the robot.
  std::optional<Mesh> carrier_for(const std::string& robot, TimePoint now) const {
    std::optional<Mesh> carrier;
    std::tuple<Presence, bool, bool, double> best;
    for (const Mesh mesh : all_meshes) {
      const auto presence = presence_on(mesh, robot);
      if (!presence) continue;
      const std::tuple rank{*presence, is_silent(robot, mesh, now), names.preferred(robot) != mesh,
                            choice.expected(robot, mesh, now).count()};
      if (carrier && rank >= best) continue;
      carrier = mesh;
      best = rank;
    }
    return carrier;
  }
};

}  // namespace slamgw
