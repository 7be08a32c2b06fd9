// SPDX-License-Identifier: Apache-2.0
// JSON with `//` and `/* */` comments, read together with each value's line. Used for the
// configuration, the credentials file and the keys file; does not know their keys.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "daemon/config/problem.hpp"

namespace slamgw {

using Json = nlohmann::ordered_json;

/// One document as read. After a syntax error, that error is the only problem and `root` is
/// unusable. A key that appears twice is a problem, and `root` holds the first.
struct LocatedJson {
  std::string file;
  Json root;
  int line = 1;  ///< of the whole document
  /// The line of each key and list element, by its path: `robots[0].id`.
  std::map<std::string, int> lines;
  bool is_complete = false;
  Problems problems;

  int line_of(const std::string& path) const { return lines.at(path); }
};
LocatedJson read_located_json(std::string_view text, const std::string& file);

/// Returns a document that is one group; otherwise reports a problem and returns nothing. `shape`:
/// the allowed form, as the problem shows it.
std::optional<LocatedJson> read_group(std::string_view text, const std::string& file,
                                      std::string_view shape, Problems& problems);

/// Describes a JSON syntax error in an operator's words. `message` is nlohmann-json's; the part of
/// the file that it quotes is left out, because that may be a secret.
std::string syntax_words(std::string_view message);

}  // namespace slamgw
