// SPDX-License-Identifier: Apache-2.0
// The JSON documents that the gateway publishes about robots and commands (docs/topics.md). Pure;
// called by Gateway.
#pragma once

#include <string>
#include <string_view>

#include "daemon/core/messages.hpp"
#include "daemon/core/robot_registry.hpp"

namespace slamgw {

/// Returns `text` as a JSON string. Octets that are not UTF-8 become U+FFFD.
std::string json_string(std::string_view text);
/// The payload of `robots/<id>`.
std::string presence_json(const Robot& robot);
/// The payload of `commands/<id>`.
std::string outcome_json(const CommandOutcome& outcome);

}  // namespace slamgw
