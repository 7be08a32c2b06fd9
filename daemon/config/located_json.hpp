// SPDX-License-Identifier: Apache-2.0
// One thing that is wrong in a configuration file, with its place. Made by the parser and its
// checks, printed by main.
#pragma once

#include <nlohmann/json.hpp>

#include <string>
#include <string_view>
#include <vector>

namespace slamgw {

/// `text` reads "what is wrong; what is allowed" and never holds a secret's value.
struct Problem {
  std::string file;
  int line = 1;     ///< counted from 1
  std::string key;  ///< `broker.uri`, `robots[1].id`; `syntax` or `file` when no key is concerned
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

// A JSON syntax error in an operator's words.

/// `message` is nlohmann-json's. What it echoes of the file is left out: it may be a secret.
std::string syntax_words(std::string_view message);

// JSON with `//` and `/* */` comments, read into a tree that knows each value's line. Knows no key
// of the configuration; used for it and for the credentials file.

/// Where a key or value stands.
struct Place {
  std::string file;
  int line = 1;  ///< counted from 1
};

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

/// Lays `over` upon `base` key by key: groups are joined, every other value (a list too) replaces
/// the one below it.
void overlay(JsonNode& base, JsonNode over);

}  // namespace slamgw
