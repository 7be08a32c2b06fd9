// SPDX-License-Identifier: Apache-2.0
// Reads the configuration file of this host, with all files that it names. Called by main, at
// start, for --check-config and on SIGHUP. Opens nothing but those files.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <system_error>

#include "daemon/config/parse.hpp"
#include "daemon/core/result.hpp"

namespace slamgw {

/// The configuration that the packaged services read.
inline constexpr const char* service_configuration = "/etc/slam-gateway/gateway.json";

/// Returns `gateway.d` beside `gateway.json`: the site's own files.
std::filesystem::path site_directory(const std::string& configuration);
/// Returns `gateway.json` and the `.json` files in `gateway.d/`, in the order of reading. Leaves
/// out hidden files, and copies that editors and dpkg make. Sets `error` if `gateway.d/` cannot be
/// read.
std::vector<std::string> configuration_files(const std::string& path, std::error_code& error);

/// Never throws because of a file's content; an unreadable file is a problem like any other. A file
/// in `gateway.d/` with another ending is a warning, unless it is a backup of an editor or dpkg.
ParseResult load_config(const std::string& path);

/// Reads the configuration for a program that runs beside the daemon as another user, without the
/// daemon's secret files. What this user may not read in `gateway.d` is a warning: it may hold a
/// secret. Where no gateway is installed, all settings have their defaults.
ParseResult load_shared_config(const std::string& path);

/// Reads the credentials again; returns those in `broker` when the file can't be used.
std::optional<Credentials> load_credentials(const BrokerSettings& broker);

/// Reads the packaged service's credentials from the file that systemd copies for it; for programs
/// that an operator runs. Nothing when that file does not exist; a Problem when it can't be used.
Result<std::optional<Credentials>, Problem> load_service_credentials();

/// Returns whether the credentials file has changed since systemd copied it for this process.
bool is_credential_outdated();

}  // namespace slamgw
