// SPDX-License-Identifier: Apache-2.0
// Reads the configuration file of this host, with all files that it names. Called by main, at
// start, for --check-config and on SIGHUP. Opens nothing but those files.
#pragma once

#include <optional>
#include <string>

#include "daemon/config/parse.hpp"
#include "daemon/core/result.hpp"

namespace slamgw {

/// `gateway.json` and what lies in `gateway.d/`, in the order of reading. Backup files of editors
/// and packages do not end in `.json`.
std::vector<std::string> configuration_files(const std::string& path);

/// Never throws for what is in the files; an unreadable file is a problem like any other. A file in
/// `gateway.d/` of another name is a warning, unless an editor or dpkg has put it aside.
ParseResult load_config(const std::string& path);

/// For a program beside the daemon, under a user of its own: reads no file that is the daemon's
/// secret. A file in `gateway.d` that this user may not read (one with a secret) is a warning;
/// where no gateway is installed, its configuration is that of all defaults.
ParseResult load_shared_config(const std::string& path);

/// The credentials as the file has them now; those in `broker` when it can't be used.
std::optional<Credentials> load_credentials(const BrokerSettings& broker);

/// The packaged service's credentials, from the file that systemd copies for it: for an operator's
/// program. Nothing where there is no such file; a Problem where it can't be used.
Result<std::optional<Credentials>, Problem> load_service_credentials();

/// The file has changed since systemd copied it for this process.
bool is_credential_outdated();

}  // namespace slamgw
