// SPDX-License-Identifier: Apache-2.0
// The audit trail's lines about operators' orders; lines about commands come from the core. Pure
// except for user_words().
#pragma once

#include <sys/types.h>

#include <optional>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/operator_order.hpp"

namespace slamgw {

struct AuditedOrder {
  std::string what;   ///< as the operator types it: `ble permit-join`
  std::string robot;  ///< the robot or robots that the order concerns; may be empty
};

/// Returns nothing for orders that only read.
std::optional<AuditedOrder> audited(const BleOrder& order);
std::optional<AuditedOrder> audited(const StoreOrder& order);

/// `error`: empty when the order succeeded; only its first line is shown.
Notice audit_notice(const std::string& who, const AuditedOrder& order, const std::string& error);

/// `uid 1000 (alice)`. The name is read from `users_file`: other sources may block the caller.
std::string user_words(uid_t uid, const char* users_file = "/etc/passwd");

}  // namespace slamgw
