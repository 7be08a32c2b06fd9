// SPDX-License-Identifier: Apache-2.0
// What the core asks about robots that several gateways could serve. Answered by the fleet's
// Ownership; without one, this gateway serves every robot.
#pragma once

#include <functional>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

struct OwnershipQuery {
  /// True while there are other gateways: then commands and wills wait for their turn.
  std::function<bool()> is_shared = [] { return false; };
  /// True where one subscription brings all commands and the broker could not name the copies of
  /// several (MQTT 3.1.1). Robots' own subscriptions to commands are then not made at the broker,
  /// unless it refuses that one.
  std::function<bool()> hears_all_commands = [] { return false; };
  /// False when another living gateway serves the robot.
  std::function<bool(const std::string& robot)> speaks_for = [](const std::string&) {
    return true;
  };
  /// Whether the robot's presence may be published: not when another living gateway serves it, and,
  /// but for `offline`, not while that is not known. Then Gateway::on_taken_over() publishes it.
  /// `has_just_come`: the robot was heard here just now.
  std::function<bool(const std::string& robot, Presence presence, bool has_just_come)>
      may_announce = [](const std::string&, Presence, bool) { return true; };
  /// Sees each message from the broker. True when it is one between gateways.
  std::function<bool(const BrokerMessage& message)> takes = [](const BrokerMessage&) {
    return false;
  };
};

}  // namespace slamgw
