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
  std::string what;          ///< as the operator types it: `ble permit-join`
  std::string robot;         ///< the robot or robots that the order concerns; may be empty
  std::string letters = {};  ///< the chosen dead letters; their number is in the answer
};

/// Returns nothing for orders that only read.
std::optional<AuditedOrder> audited(const BleOrder& order);
std::optional<AuditedOrder> audited(const StoreOrder& order);

/// Only the first line of an error is shown.
Notice audit_notice(const std::string& who, const AuditedOrder& order, const OrderAnswer& answer);

/// `uid 1000 (alice)`. The name is read from `users_file`: other sources may block the caller.
std::string user_words(uid_t uid, const char* users_file = "/etc/passwd");

}  // namespace slamgw
