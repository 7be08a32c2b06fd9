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
#include "daemon/delivery/message_store.hpp"

namespace slamgw {

struct Status {
  /// A topic that the broker does not take for now.
  struct RefusedTopic {
    std::string topic;
    Refusal refusal;
    std::uint64_t waiting = 0;
    std::uint64_t tries = 0;
    std::chrono::seconds since{0};
  };
  struct Broker {
    std::string uri;
    BrokerLink link;
    std::uint64_t refused_topics = 0;
    std::vector<MissingRight> missing_rights;
    std::vector<RefusedTopic> refused;  ///< the few that have waited longest
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
    std::string role{};          ///< of this host in it, where that is known: BorderRouterWatch
  };
  struct Robots {
    std::uint64_t online = 0;
    std::uint64_t asleep = 0;
    std::uint64_t offline = 0;
    std::uint64_t known = 0;
    std::uint64_t untracked = 0;
    std::uint64_t deaf = 0;       ///< online, and do not hear the gateway
    std::uint64_t contested = 0;  ///< another client uses their ids
  };
  struct Messages {
    std::uint64_t up = 0;
    std::uint64_t down = 0;
    std::uint64_t published = 0;
    std::uint64_t dropped = 0;
    std::uint64_t refused = 0;
    std::uint64_t set_aside = 0;
    std::uint64_t rejected = 0;
    std::uint64_t not_retained = 0;  ///< the robot has too many retained topics
    std::uint64_t stored = 0;
    std::uint64_t inbound_dropped = 0;  ///< the broker's, lost for want of room in the Handover
  };
  struct Commands {
    std::uint64_t open = 0;  ///< without an outcome yet
    std::uint64_t late = 0;  ///< outcomes that came when the command had ended
  };
  struct Store {
    std::string_view state;
    std::string why;
    std::uint64_t depth = 0;
    std::uint64_t bytes = 0;
    std::uint64_t max_bytes = 0;
    bool is_full = false;
    StoreShares::Share largest;   ///< of the robot that has stored most
    bool is_nearly_full = false;  ///< and that robot has filled half of it
    std::chrono::seconds oldest_age{0};
    std::uint64_t dead_letters = 0;
    std::uint64_t failures = 0;
  };
  /// Retained topics that robots have left at the broker.
  struct Retained {
    std::uint64_t topics = 0;
    std::string most_by;
    std::uint64_t most = 0;
  };
  struct Queue {
    std::uint64_t depth = 0;
    std::uint64_t bytes = 0;
    std::uint64_t max_bytes = 0;
  };

  std::string version;
  std::chrono::seconds uptime{0};
  std::string gateway;
  std::string configuration;  ///< the file that the daemon reads
  Broker broker;
  PerMesh<MeshLink> meshes;
  Robots robots;
  Messages messages;
  Commands commands;
  Store store;
  Retained retained;
  Queue queue;
  Counters control;
  Counters fleet;
  std::uint64_t memory_rss_bytes = 0;
};

struct RobotStatus {
  std::string id;
  RequiredMesh mesh;
  std::string address{};
  Presence state = Presence::offline;
  WallTime since{};
  WallTime last_seen{};     ///< any sign of life; the epoch: none since the daemon started
  std::string last_type{};  ///< of its last message
  bool is_deaf = false;
  bool is_contested = false;
  bool is_banned = false;
  std::string why{};  ///< why it is offline, deaf or contested, as far as known; else empty
  std::uint64_t messages = 0;
  std::uint64_t commands = 0;
  std::uint64_t bytes_up = 0;  ///< of payloads
  std::uint64_t bytes_down = 0;
  std::uint64_t repeats = 0;
  std::uint64_t gaps = 0;  ///< RobotNumbers::gaps
  double rate_hz = 0;
  std::optional<LatencyWindow::Percentiles> latency{};
  std::optional<RadioFacts> radio{};
  std::uint64_t queue = 0;
  PerMesh<MeshPresence> on_mesh{};
};

nlohmann::json to_json(const Status& status);
nlohmann::json to_json(const std::vector<RobotStatus>& robots);

/// Why a robot is offline, or what is wrong with it, in words for operators; else empty.
std::string why_absent(const RobotStatus& robot, const Status::MeshLink& link);

}  // namespace slamgw
