// SPDX-License-Identifier: Apache-2.0
// The parts of the daemon's status as JSON, for `slam-gatewayctl --json`, the control socket and
// the `stats` topic (names are stable). StatusCollector joins them. Pure.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/retained_topics.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/robot_registry.hpp"
#include "daemon/delivery/outbox.hpp"
#include "daemon/delivery/refused_topics.hpp"

namespace slamgw {

struct MeshLink {
  bool is_enabled = false;
  bool is_up = false;
  std::string detail;
  Counters counters;
  std::optional<MeshPlaces> places{};
  LatencyHistogram latency{};  ///< of acknowledged messages
  std::uint64_t up = 0;        ///< messages from its robots
  std::uint64_t down = 0;      ///< messages to its robots
  std::string role{};          ///< of this host in the mesh, if BorderRouterWatch knows it
};
nlohmann::json to_json(const MeshLink& mesh);
nlohmann::json to_json(const PerMesh<MeshLink>& meshes);

nlohmann::json to_json(const Counters& counters);

/// The topics that the broker refuses.
struct RefusedSummary {
  std::uint64_t topics = 0;
  std::vector<RefusedTopic> list;  ///< those that have waited longest
};
/// The broker is "refusing" while the link is up, but some topics are refused.
nlohmann::json broker_json(const std::string& uri, const BrokerLink& link,
                           const RefusedSummary& refused,
                           const std::vector<MissingRight>& missing_rights, TimePoint now);

/// `filled_by`: the robot that has stored most, while the store is nearly full, half of it from
/// that robot.
nlohmann::json store_json(const Outbox& outbox, std::uint64_t max_bytes, TimePoint now);

/// Retained topics that robots have left at the broker.
nlohmann::json retained_json(const RetainedTopics& retained);

/// Returns how many robots are in each state, and how many are in trouble.
Counters counts_of(const RobotRegistry& robots);

/// Facts for a robot's row that the registry does not know.
struct RobotSurroundings {
  bool is_banned = false;
  std::uint64_t queue = 0;                ///< commands that wait for the robot
  MeshLink link{};                        ///< of Robot::mesh()
  std::chrono::seconds offline_after{1};  ///< `presence.offline_after_s`
};

/// A row of `slam-gatewayctl --json robots`. `now`: for rates and latencies.
nlohmann::json robot_row(const std::string& id, const Robot& robot,
                         const RobotSurroundings& surroundings, TimePoint now);

/// Returns why a robot is offline, or what is wrong with it, in words for operators; else empty.
std::string why_absent(const Robot& robot, const RobotSurroundings& surroundings);

}  // namespace slamgw
