// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl backup` and `restore`: configuration, credentials, the BLE mesh's keys, and the
// messages and sessions that are kept, in one archive (tar, gzip). The archive holds secrets.
#pragma once

#include <functional>
#include <string>

#include "ctl/host/installation.hpp"

namespace slamgw::ctl {

/// Writes `file` with mode 0600; an existing one is replaced only when the new one is complete. The
/// service stands still for the moment of copying, because its databases are open. A Failure for
/// whatever goes wrong. Gives what was done, for people.
std::string backup(const Installation& installation, const std::string& file);

/// Puts an archive's files where the configuration here says, with owners and modes of our own;
/// what was there is kept beside it under a name with the time. An archive with any other file, a
/// link or a device is a Failure, and changes nothing. `may_replace` is asked about the files here
/// that differ.
std::string restore(const Installation& installation, const std::string& file,
                    const std::function<bool(const std::string& replaced)>& may_replace);

}  // namespace slamgw::ctl
