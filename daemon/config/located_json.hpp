// SPDX-License-Identifier: Apache-2.0
// JSON with `//` and `/* */` comments, read into a tree that knows each value's line. Knows no key
// of the configuration; used for it and for the credentials file.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/config/problem.hpp"

namespace slamgw {

/// A value and where it stands. Members of an object and elements of an array are in `children`, in
/// the file's order; `value` is then an empty object or array.
struct JsonNode {
  std::string key;  ///< empty for the root and for elements of an array
  Place place;      ///< of the key where there is one
  nlohmann::json value;
  std::vector<JsonNode> children;
};

/// Reads one document. A syntax error is the only problem then, and the tree is unusable; a key
/// that appears twice is a problem beside which the tree holds the first.
struct LocatedJson {
  JsonNode root;
  bool is_complete = false;
  Problems problems;
};
LocatedJson read_located_json(std::string_view text, const std::string& file);

/// The members of a document that is one group; nothing, and a problem, when it is none. `shape`:
/// what is allowed, for people.
std::optional<std::vector<JsonNode>> read_group(std::string_view text, const std::string& file,
                                                std::string_view shape, Problems& problems);

/// A JSON syntax error in an operator's words. `message` is nlohmann-json's. What it echoes of the
/// file is left out: it may be a secret.
std::string syntax_words(std::string_view message);

/// Lays `over` upon `base` key by key: groups are joined, every other value (a list too) replaces
/// the one below it.
void overlay(JsonNode& base, JsonNode over);

}  // namespace slamgw
