// SPDX-License-Identifier: Apache-2.0
// Collects the status from the parts of the daemon. Reads only.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "daemon/app/fleet_member.hpp"
#include "daemon/app/meshes.hpp"
#include "daemon/app/status.hpp"
#include "daemon/config/config.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/delivery/outbox.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/observability/service_notifier.hpp"

namespace slamgw {

/// Returns the first address of the broker in the configuration.
std::string broker_uri(const BrokerSettings& broker);

/// The referenced parts must outlive this object.
struct StatusCollector {
  /// `links`: mesh_links(), with what other parts know of them. `control`: counters of the control
  /// socket.
  nlohmann::json status(const PerMesh<MeshLink>& links, const Counters& control,
                        TimePoint now) const;
  /// Returns an array with a row for each robot, or only for the robot with this id.
  nlohmann::json robots(const std::optional<std::string>& only, TimePoint now) const;
  ServiceState service_state() const;
  PerMesh<MeshLink> mesh_links() const;

  const Config& config;
  const BrokerLink& broker;
  const Gateway& gateway;
  const Outbox& outbox;
  const Meshes& meshes;
  const Upstream& upstream;
  const FleetMember& fleet;
  const TimePoint started;
};

}  // namespace slamgw
