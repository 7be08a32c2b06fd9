// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl check ROBOT`: watches one robot for some minutes and says what its firmware
// should do otherwise. Facts are gathered first; judging them does no I/O.
#pragma once

#include <chrono>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "ctl/connection.hpp"
#include "ctl/host/doctor.hpp"

namespace slamgw::ctl {

struct WatchedRobot {
  /// Events of its messages and commands, as `watch` reports them; at most max_events.
  std::vector<nlohmann::json> events;
  nlohmann::json client;  ///< answer to `mqttsn clients ROBOT`; null without a session
  nlohmann::json config;  ///< answer to `ble config ROBOT`; null when not a node, or silent
  std::chrono::seconds watched{0};

  static constexpr std::size_t max_events = 100'000;
};

/// Watches the robot for `time`, then asks the daemon for its session or configuration.
WatchedRobot watch_robot(const std::string& robot, std::chrono::seconds time,
                         const std::string& socket);
/// Returns a finding for each habit that costs the robot messages, air time or battery.
std::vector<Finding> judge_robot(const WatchedRobot& robot);

}  // namespace slamgw::ctl
