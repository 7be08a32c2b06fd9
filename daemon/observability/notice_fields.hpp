// SPDX-License-Identifier: Apache-2.0
// The journal's fields of a Notice, and the MESSAGE_ID of each kind of entry (documented in
// slam-gatewayd(8); they never change). Pure.
#pragma once

#include <string_view>

#include "daemon/core/messages.hpp"
#include "daemon/observability/log.hpp"

namespace slamgw {

/// 32 hex digits (sd-id128(3)); empty for Occasion::other.
std::string_view message_id_of(Occasion occasion);
LogFields notice_fields(const Notice& notice);

}  // namespace slamgw
