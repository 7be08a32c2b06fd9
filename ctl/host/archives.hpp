// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl backup` and `restore`: configuration, credentials, the BLE mesh's keys, and the
// messages and sessions that are kept, in one archive (tar, gzip), which holds secrets; and
// `report`, what support needs to see, without secrets.
#pragma once

#include <functional>
#include <string>
#include <string_view>

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

/// The text of a configuration file with the value of each key that may be secret replaced; keys
/// whose names speak of secrets too, known or not. Nothing of a text that is no JSON.
std::string without_secrets(std::string_view text);

/// Writes `file` (tar, gzip, mode 0600). A failure stands in the place of what cannot be had; only
/// a file that cannot be written is a Failure. Gives what was done, for people.
std::string report(const Installation& installation, const std::string& socket,
                   const std::string& file);

}  // namespace slamgw::ctl
