// SPDX-License-Identifier: Apache-2.0
// What the core asks about robots that several gateways could serve (docs/fleet.md). Answered by
// the application; without an answer, this gateway serves every robot.
#pragma once

#include <functional>
#include <string>

namespace slamgw {

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
  /// No other gateway is about.
  std::function<bool()> is_alone = [] { return true; };
};

}  // namespace slamgw
