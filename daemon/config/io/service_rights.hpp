// SPDX-License-Identifier: Apache-2.0
// What the packaged service's user may read, asked by root: `sudo slam-gatewayd --check-config`
// would read every file, and the service would then end with status 78.
#pragma once

#include <string>

namespace slamgw {

inline constexpr const char* service_user = "slam-gateway";

/// Whether that user may open the file for reading, with all of the user's groups. True also when
/// it cannot be asked: the caller is not root, or there is no such user. Starts a process that
/// opens the file, and waits for it.
bool may_user_read(const std::string& user, const std::string& path);

}  // namespace slamgw
