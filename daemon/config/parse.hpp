// SPDX-License-Identifier: Apache-2.0
// Parses the configuration's text into Config and finds all its problems in one run. Pure except
// for its calls to Files. Reading the file itself: load.hpp.
#pragma once

#include <string>
#include <vector>

#include "daemon/config/files.hpp"
#include "daemon/config/parse_result.hpp"

namespace slamgw {

/// The environment on which defaults depend.
struct Environment {
  std::string host_name;
  std::string credentials_directory;  ///< systemd's $CREDENTIALS_DIRECTORY, or empty
  /// The file that systemd copies to the service's credential `broker`; the operator edits this
  /// file. Empty when it does not exist, or when another configuration is read.
  std::string credential_source{};
  /// True when the daemon itself reads. Other programs do not read the daemon's secrets: the
  /// credentials, the files of `broker.tls`, and robots' keys.
  bool is_daemon = true;
};

/// One file of the configuration.
struct ConfigFile {
  std::string name;  ///< as shown in problems
  std::string text;
};

/// `parts`: at least one; later parts override earlier ones key by key. Relative paths in all parts
/// start at the directory of the first.
ParseResult parse_config(const std::vector<ConfigFile>& parts, const Environment& environment,
                         const Files& files);

/// Parses the keys of one file alone. Problems are only those that the values themselves have.
ParseResult parse_keys(const ConfigFile& part);

}  // namespace slamgw
