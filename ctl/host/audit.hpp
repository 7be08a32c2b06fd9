// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl audit`: who asked the gateway for what, and what came of it, read back from the
// journal; and the entries about what this program does without the daemon.
#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "daemon/core/time.hpp"
#include "daemon/observability/audit_notice.hpp"

namespace slamgw::ctl {

/// When an entry of `journalctl -o json` was written; the epoch when it does not say so.
WallTime time_of_entry(const nlohmann::json& entry);

/// What `journalctl -o json` prints, as an array of `{"at", "who", "what", "robot", "outcome",
/// "text"}`, oldest first. Other lines are left out.
nlohmann::json audit_entries(std::string_view journal);
/// A line for each.
std::string audit_text(const nlohmann::json& entries);

/// The newest entries, of one robot when `robot` is not empty. Throws Failure, with what to do,
/// when there is no journal, or nothing of the gateway in it.
nlohmann::json read_audit(const std::string& robot);

/// Does what `act` does, and writes to the journal what came of it.
std::string recorded(const AuditedOrder& order, const std::function<std::string()>& act);

}  // namespace slamgw::ctl
