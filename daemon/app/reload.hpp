// SPDX-License-Identifier: Apache-2.0
// SIGHUP and `slam-gatewayctl reload`: which parts of a configuration that was read again take
// effect at once, and words for those that do not. Pure.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "daemon/config/config.hpp"

namespace slamgw {

struct Reload {
  Config config;  ///< in force from now on
  /// The keys that differ and are in force from now on, as a list for people; may be empty.
  std::string in_force{};
  /// The groups of keys that differ and are only read at start, as a list for people; may be empty.
  std::string needs_restart{};
  /// Default names (a client id, `ble-0100`) of robots that have another name now.
  std::vector<std::string> replaced_names{};
};

/// Separates the changes that take effect at once from those that need a restart.
Reload reload_of(const Config& now, Config wanted);

/// Returns the answer of `slam-gatewayctl reload`: `in_force` and, if not empty, `needs_restart`.
nlohmann::ordered_json answer_json(const Reload& reload);

}  // namespace slamgw
