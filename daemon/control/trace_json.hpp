// SPDX-License-Identifier: Apache-2.0
// A TraceEvent as JSON: the lines of `slam-gatewayctl --json watch`. People script against the
// names. Pure.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "daemon/core/trace.hpp"

namespace slamgw::control {

/// Members that do not apply are left out: `at` (UTC, microseconds), `event`, `robot`, `mesh`,
/// `address`, `topic`, `type`, `direction`, `qos`, `message_id`, `dup`, `bytes`, `rssi_dbm`, `ttl`,
/// `hops`, `latency_us`, `command_id`, `outcome`, `why`, `update`, `payload` (hex), and for people
/// `cmd` (x and y) or `text`, where the payload reads as such.
nlohmann::ordered_json to_json(const TraceEvent& event);
/// In place of events that a listener was too slow for: `at`, `event` "lost", `lost` (how many).
nlohmann::ordered_json lost_json(std::uint64_t count, WallTime at);

}  // namespace slamgw::control
