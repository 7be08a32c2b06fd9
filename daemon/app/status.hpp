// SPDX-License-Identifier: Apache-2.0
// The daemon's status as values, and its JSON for `slam-gatewayctl --json`, the control socket and
// the `stats` topic (names are stable). Pure.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/robot_registry.hpp"
#include "daemon/delivery/refused_topics.hpp"

namespace slamgw {

struct Status {
  struct Broker {
    std::string uri;
    BrokerLink link;
    std::uint64_t refused_topics = 0;
    std::vector<MissingRight> missing_rights;
    std::vector<RefusedTopic> refused;  ///< the topics that have waited longest
    /// The link is up, but the broker refuses some topics.
    bool is_refusing() const { return link.is_up && refused_topics > 0; }
  };
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
  struct Store {
    std::string_view state;
    std::string why;
    std::uint64_t depth = 0;
    std::uint64_t bytes = 0;
    std::uint64_t max_bytes = 0;
    bool is_full = false;
    SlotSums::Sum largest;        ///< of the robot that has stored most
    bool is_nearly_full = false;  ///< the store is nearly full, half of it from that robot
    std::chrono::seconds oldest_age{0};
    std::uint64_t dead_letters = 0;
    std::uint64_t dead_letter_bytes = 0;
    bool has_little_room_for_letters = false;  ///< less than a quarter of their part is free
    std::uint64_t failures = 0;
  };
  /// Retained topics that robots have left at the broker.
  struct Retained {
    std::uint64_t topics = 0;
    std::string most_by;
    std::uint64_t most = 0;
  };

  TimePoint now{};  ///< when the status was collected
  std::string version;
  std::chrono::seconds uptime{0};
  std::string gateway;
  std::string configuration;  ///< the file that the daemon reads
  Broker broker;
  PerMesh<MeshLink> meshes;
  Counters robots;    ///< counts_of(RobotRegistry)
  Counters messages;  ///< `inbound_dropped`: from the broker, lost because the Handover was full
  Counters commands;  ///< `open`: without an outcome yet; `late`: outcomes after the end
  Store store;
  Retained retained;
  Counters queue;
  Counters control;
  Counters fleet;
  std::uint64_t memory_rss_bytes = 0;
};

nlohmann::json to_json(const Status& status);

/// Returns how many robots are in each state, and how many are in trouble.
Counters counts_of(const RobotRegistry& robots);

/// Facts for a robot's row that the registry does not know.
struct RobotSurroundings {
  bool is_banned = false;
  std::uint64_t queue = 0;                ///< commands that wait for the robot
  Status::MeshLink link{};                ///< of Robot::mesh()
  std::chrono::seconds offline_after{1};  ///< `presence.offline_after_s`
};

/// A row of `slam-gatewayctl --json robots`. `now`: for rates and latencies.
nlohmann::json robot_row(const std::string& id, const Robot& robot,
                         const RobotSurroundings& surroundings, TimePoint now);

/// Returns why a robot is offline, or what is wrong with it, in words for operators; else empty.
std::string why_absent(const Robot& robot, const RobotSurroundings& surroundings);

}  // namespace slamgw
