// SPDX-License-Identifier: Apache-2.0
// The settings of the core, from the configuration.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "daemon/core/command_ledger.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/time.hpp"

namespace slamgw {

struct GatewaySettings {
  std::string version;
  UpdateMode update_mode = UpdateMode::positions;
  WallTime started{};  ///< "since" in `state`
  std::size_t max_open_commands = CommandLedger::default_max_open;
  std::vector<std::string> retain = {"*"};  ///< `topics.retain`
  bool describes_robots = false;            ///< `topics.home_assistant`
};

}  // namespace slamgw
