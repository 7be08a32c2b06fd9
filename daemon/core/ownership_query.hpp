// SPDX-License-Identifier: Apache-2.0
// What the core asks about robots that several gateways could serve. Answered by the fleet's
// Ownership; without one, every robot is this gateway's.
#pragma once

#include <functional>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

struct OwnershipQuery {
  /// Other gateways are about: commands and wills wait for their turn.
  std::function<bool()> is_shared = [] { return false; };
  /// Every command comes by one subscription, of whose copies a broker could not tell (MQTT 3.1.1):
  /// unless the broker refuses it, robots' own subscriptions to commands stay away from there.
  std::function<bool()> hears_all_commands = [] { return false; };
  /// False when another living gateway serves the robot: its presence is not this gateway's to
  /// tell.
  std::function<bool(const std::string& robot)> speaks_for = [](const std::string&) {
    return true;
  };
  /// Shown each message from the broker. True: it is between gateways, and not for robots.
  std::function<bool(const BrokerMessage& message)> takes = [](const BrokerMessage&) {
    return false;
  };
};

}  // namespace slamgw
