// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl backup` and `restore`: configuration, credentials, the BLE mesh's keys, and the
// messages and sessions that are kept, in one archive (tar, gzip), which holds secrets. `report`:
// the facts that support needs, without secrets.
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "ctl/host/installation.hpp"

namespace slamgw::ctl {

/// Writes `file`, a new one, with mode 0600. Stops the service while it copies, because the service
/// has its databases open. Throws Failure on any fault. Returns the result in words.
std::string backup(const Installation& installation, const std::string& file);

/// Puts an archive's files where this host's configuration says, with owners and modes of our own.
/// Keeps the present files beside them under a name with the time. When a step fails, they come
/// back. An archive with any other file,
/// a link or a device is a Failure, and changes nothing. Calls `may_replace` with the names of
/// present files that differ. Throws Failure on any fault, and while a daemon runs with this
/// configuration that is not the service.
std::string restore(const Installation& installation, const std::string& file,
                    const std::function<bool(const std::string& replaced)>& may_replace);

/// Returns a configuration file's text with the values that its keys allow, but without the OOB
/// value. Anything else may be a misplaced secret. Returns nothing of a text that is not a JSON
/// object.
std::string without_secrets(std::string_view text);

/// Writes `file` (tar, gzip, mode 0600). Where a fact is not available, the report holds the reason
/// instead. Throws Failure only if the file cannot be written. Returns the result in words.
std::string report(const Installation& installation, const std::string& socket,
                   const std::string& file);

}  // namespace slamgw::ctl
