// SPDX-License-Identifier: Apache-2.0
// Why a tty can't be opened, and what to do about it, in words. Pure; serial_port asks the system.
#pragma once

#include <string>

namespace slamgw::ble {

/// Who may use a device node, and who tries to.
struct NodeAccess {
  std::string group;    ///< name, or number when it has none
  unsigned mode = 0;    ///< permission bits, 0777
  std::string process;  ///< name of this process's user
};

/// A sentence without a full stop. `error`: errno of the attempt.
std::string explain_open_failure(const std::string& path, int error, const NodeAccess& access);

}  // namespace slamgw::ble
