// SPDX-License-Identifier: Apache-2.0
// JSON with `//` and `/* */` comments, read into a tree that knows each value's line. Used for the
// configuration, the credentials file and the keys file; does not know their keys.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/config/problem.hpp"

namespace slamgw {

/// A value and its place. Members of an object and elements of an array are in `children`, in
/// the file's order; `value` is then an empty object or array.
struct JsonNode {
  std::string key;  ///< empty for the root and for elements of an array
  Place place;      ///< the key's, if there is a key; else the value's
  nlohmann::json value;
  std::vector<JsonNode> children;
};

/// One document as read. After a syntax error, that error is the only problem and the tree is
/// unusable. A key that appears twice is a problem, and the tree holds the first.
struct LocatedJson {
  JsonNode root;
  bool is_complete = false;
  Problems problems;
};
LocatedJson read_located_json(std::string_view text, const std::string& file);

/// Returns the members of a document that is one group; otherwise reports a problem and returns
/// nothing. `shape`: the allowed form, as the problem shows it.
std::optional<std::vector<JsonNode>> read_group(std::string_view text, const std::string& file,
                                                std::string_view shape, Problems& problems);

/// Describes a JSON syntax error in an operator's words. `message` is nlohmann-json's; the part of
/// the file that it quotes is left out, because that may be a secret.
std::string syntax_words(std::string_view message);

/// Merges `over` into `base` key by key: groups are joined, every other value (a list too) replaces
/// the value in `base`.
void overlay(JsonNode& base, JsonNode over);

}  // namespace slamgw
