// SPDX-License-Identifier: Apache-2.0
// What the gateway publishes about robots and commands, as JSON (docs/topics.md). Pure;
// called by Gateway.
#pragma once

#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/robot_registry.hpp"

namespace slamgw {

/// For `robots/<id>`.
std::string presence_json(const Robot& robot);
/// For `commands/<id>`.
std::string outcome_json(const CommandOutcome& outcome);

}  // namespace slamgw
