// SPDX-License-Identifier: Apache-2.0
// Checks, for root, which files the packaged service's user may read. Without this check,
// `sudo slam-gatewayd --check-config` would accept files with which the service ends (status 78).
#pragma once

#include <string>

namespace slamgw {

inline constexpr const char* service_user = "slam-gateway";

/// Returns whether the user, with all its groups, may open the file for reading. True also when
/// that cannot be checked: the caller is not root, or the user does not exist. Starts a process
/// that opens the file, and waits for it.
bool may_user_read(const std::string& user, const std::string& path);

}  // namespace slamgw
