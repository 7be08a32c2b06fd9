// SPDX-License-Identifier: Apache-2.0
// What the parts of Ownership share: what this gateway knows of the others, and what is to be done.
#pragma once

#include <cstdint>
#include <string>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/fleet/claim_table.hpp"
#include "daemon/fleet/fleet_topics.hpp"
#include "daemon/fleet/lease.hpp"
#include "daemon/fleet/ownership_action.hpp"
#include "daemon/fleet/peers.hpp"
#include "daemon/fleet/taken_commands.hpp"

namespace slamgw::fleet {

enum class Phase : std::uint8_t {
  alone,    ///< nobody else is about: every robot is ours, nothing is said
  joining,  ///< listens to the others before it claims what it has
  member,
};

struct Membership {
  Membership(FleetTopics own_topics, Life process);

  bool is_mine(const Claim& claim) const {
    return claim.gateway == me && claim.life == lease.life();
  }
  /// Another gateway's, which lives.
  bool is_living(const Claim& claim, TimePoint now) const {
    return claim.gateway != me && peers.is_alive(claim.gateway, claim.life, now);
  }
  /// A member whose lease lasts.
  bool may_act(TimePoint now) const { return phase == Phase::member && lease.is_valid(now); }

  void publish(std::string topic, const Body& body, Qos qos = Qos::at_least_once);
  void publish_to_all(const Body& body) { publish(topics.all(), body); }
  void notice(Severity severity, std::string text, const std::string& robot = {});

  const FleetTopics topics;
  const std::string me;
  Phase phase = Phase::alone;
  Lease lease;
  Peers peers;
  ClaimTable table;
  TakenCommands commands;
  ActionQueue<OwnershipAction> actions;
};

}  // namespace slamgw::fleet
