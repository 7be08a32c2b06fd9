// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl audit`: reads operators' orders and their outcomes from the journal. Also writes
// the entries about orders that this program carries out without the daemon.
#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "daemon/core/time.hpp"
#include "daemon/observability/audit_notice.hpp"

namespace slamgw::ctl {

/// Returns when an entry of `journalctl -o json` was written; the epoch when it has no time.
WallTime time_of_entry(const nlohmann::json& entry);

/// Turns the output of `journalctl -o json` into an array of `{"at", "who", "what", "robot",
/// "outcome", "text"}`, oldest first. Leaves out other lines.
nlohmann::json audit_entries(std::string_view journal);
/// Returns a line for each entry.
std::string audit_text(const nlohmann::json& entries);

/// Returns the newest entries, of one robot when `robot` is not empty. Throws Failure, with the
/// remedy, when there is no journal, or when it has no entry of the gateway.
nlohmann::json read_audit(const std::string& robot);

/// Calls `act`, writes the order's outcome to the journal, and returns or throws as `act` does.
std::string recorded(const AuditedOrder& order, const std::function<std::string()>& act);

}  // namespace slamgw::ctl
