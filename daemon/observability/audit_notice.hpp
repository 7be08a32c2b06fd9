// SPDX-License-Identifier: Apache-2.0
// The lines of the audit trail about what operators order; those about commands come from the core.
// Pure but for user_words().
#pragma once

#include <sys/types.h>

#include <optional>
#include <string>

#include "daemon/core/messages.hpp"
#include "daemon/core/operator_order.hpp"

namespace slamgw {

struct AuditedOrder {
  std::string what;   ///< as it is typed: `ble permit-join`
  std::string robot;  ///< or whom else it is about; may be empty
};

/// Nothing for orders that only read.
std::optional<AuditedOrder> audited(const BleOrder& order);
std::optional<AuditedOrder> audited(const StoreOrder& order);

/// `error`: of an order that failed; only its first line is shown.
Notice audit_notice(const std::string& who, const AuditedOrder& order, const std::string& error);

/// `uid 1000 (alice)`. The name is that of /etc/passwd: other sources may make the caller wait.
std::string user_words(uid_t uid);

}  // namespace slamgw
