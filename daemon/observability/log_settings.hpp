// SPDX-License-Identifier: Apache-2.0
// The settings of the log (`log.*`); defaults as in config/gateway.json.
#pragma once

#include <cstdint>

#include "daemon/core/messages.hpp"

namespace slamgw {

enum class TrafficLogMode : std::uint8_t { all, sampled, off };

struct LogSettings {
  Severity level = Severity::info;
  TrafficLogMode traffic = TrafficLogMode::sampled;
  bool operator==(const LogSettings&) const = default;
};

}  // namespace slamgw
