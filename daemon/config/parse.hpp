// SPDX-License-Identifier: Apache-2.0
// The configuration's text into Config, with every problem in it found in one run. Pure but for
// what it asks of Files. Reading the file itself: load.hpp.
#pragma once

#include <map>
#include <string>

#include "daemon/config/config.hpp"
#include "daemon/config/files.hpp"
#include "daemon/config/problem.hpp"
#include "daemon/config/schema.hpp"

namespace slamgw {

/// What defaults depend on.
struct Surroundings {
  std::string host_name;
  std::string credentials_directory;  ///< systemd's $CREDENTIALS_DIRECTORY, or empty
  /// The file that the service's systemd credential `broker` is copied from: the one that an
  /// operator edits. Empty when there is none, or when another configuration is read.
  std::string credential_source{};
  /// Whether the daemon itself reads. Other programs leave its secrets alone: the credentials, the
  /// files of `broker.tls`, and robots' keys.
  bool is_daemon = true;
};

/// One file of the configuration.
struct ConfigFile {
  std::string name;  ///< as problems call it
  std::string text;
};

struct ParseResult {
  Config config;      ///< to be used only when there are no problems
  Problems problems;  ///< by file in the order of reading, and by line
  Problems warnings;  ///< what works, but should be looked at by an operator
  Problems notices;   ///< what does nothing, good or bad
  /// Where each key, group and list element is set that is set: `robots[0].id`.
  std::map<std::string, Place> places;
};

/// `parts`: at least one; later ones win key by key. Relative paths in all of them start at the
/// directory of the first.
ParseResult parse_config(const std::vector<ConfigFile>& parts, const Surroundings& surroundings,
                         const Files& files);

}  // namespace slamgw
