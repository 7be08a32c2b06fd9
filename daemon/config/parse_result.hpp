// SPDX-License-Identifier: Apache-2.0
// The configuration as read so far: its values, the places of its keys, and what is wrong. The
// parser, its checks and the readers of secret files add to it.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "daemon/config/config.hpp"
#include "daemon/config/problem.hpp"

namespace slamgw {

struct ParseResult {
  Config config;      ///< to be used only when there are no problems
  Problems problems;  ///< by file in the order of reading, and by line
  Problems warnings;  ///< settings that work, but need an operator's attention
  Problems notices;   ///< keys without any effect
  /// The place of each key, group and list element that a file sets: `robots[0].id`.
  std::map<std::string, Place> places;
  std::set<std::string> secrets;  ///< of these keys, those whose values never show
  std::string file;               ///< the first file, beside which relative paths start

  bool is_set(const std::string& key) const {
    const auto found = places.find(key);
    return found != places.end() && !found->second.is_null;
  }
  /// Adds a problem or a warning at the place of the key, or else of the nearest group above it
  /// that some file sets.
  void problem(const std::string& key, std::string text) { add(problems, key, std::move(text)); }
  void warning(const std::string& key, std::string text) { add(warnings, key, std::move(text)); }

 private:
  void add(Problems& list, const std::string& key, std::string text) const;
};

/// A file that the configuration names.
struct NamedFile {
  std::string key;
  std::string path;
};
/// Returns the certificate, secret and text files that are set.
std::vector<NamedFile> named_files(const Config& config);

}  // namespace slamgw
