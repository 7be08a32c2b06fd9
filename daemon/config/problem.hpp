// SPDX-License-Identifier: Apache-2.0
// A fault in a configuration file, with its place. Made by the parser and its checks, printed by
// main.
#pragma once

#include <string>
#include <vector>

namespace slamgw {

/// The place of a key or value.
struct Place {
  std::string file;
  int line = 1;          ///< counted from 1
  bool is_null = false;  ///< the value is null, as if the key were not set
};

/// `text` reads "what is wrong; what is allowed" and never holds a secret's value.
struct Problem {
  std::string file;
  int line = 1;     ///< counted from 1
  std::string key;  ///< `broker.uri`, `robots[1].id`; without a key, `syntax` or `file`
  std::string text;
  bool operator==(const Problem&) const = default;
};
using Problems = std::vector<Problem>;

/// `FILE:LINE: key.path: what is wrong; what is allowed`, without a line end. Control characters,
/// which keys and texts of the file may hold, become `?`: a problem is one line.
inline std::string to_string(const Problem& problem) {
  std::string line =
      problem.file + ":" + std::to_string(problem.line) + ": " + problem.key + ": " + problem.text;
  for (char& c : line)
    if (static_cast<unsigned char>(c) < 0x20 || c == '\x7f') c = '?';
  return line;
}

}  // namespace slamgw
