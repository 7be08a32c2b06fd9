// SPDX-License-Identifier: Apache-2.0
// The configuration's text into Config, with every problem in it found in one run. Pure but for
// what it asks of Files. Reading the file itself: load.hpp.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "daemon/config/config.hpp"
#include "daemon/config/files.hpp"
#include "daemon/config/problem.hpp"

namespace slamgw {

/// What defaults depend on.
struct Surroundings {
  std::string host_name;
  std::string credentials_directory;  ///< systemd's $CREDENTIALS_DIRECTORY, or empty
};

struct ParseResult {
  Config config;      ///< to be used only when there are no problems
  Problems problems;  ///< by line; then those in other files
  Problems warnings;  ///< what works, but somebody should look at
  /// The line of each key, group and list element that the file sets: `robots[0].id`.
  std::map<std::string, int> lines;

  bool is_set(const std::string& key) const { return lines.contains(key); }
};

/// `file_name` is how problems call the file; its directory is where relative paths start.
ParseResult parse_config(std::string_view text, const std::string& file_name,
                         const Surroundings& surroundings, const Files& files);

}  // namespace slamgw
