// SPDX-License-Identifier: Apache-2.0
// suggestion() of schema.hpp: finds the known key that a misspelt key was meant to be.
#include <limits>
#include <set>
#include <utility>

#include "daemon/config/schema.hpp"
#include "daemon/core/edit_distance.hpp"

namespace slamgw {
namespace {

/// A key of the same name in another group beats a neighbour that needs this many more edits.
constexpr std::size_t elsewhere_penalty = 3;
/// Only this many characters of a name are compared, which bounds the work.
constexpr std::size_t longest_compared = 64;

struct Split {
  std::string_view parent;
  std::string_view name;
};

Split split_path(std::string_view path) {
  const std::size_t dot = path.rfind('.');
  if (dot == std::string_view::npos) return {{}, path};
  return {path.substr(0, dot), path.substr(dot + 1)};
}

/// Makes `mqtt_sn`, `mqtt-sn` and `MqttSn` equal to `mqttsn`; keeps units at the end.
std::string plain(std::string_view name) {
  std::string result;
  for (const char c : name.substr(0, longest_compared)) {
    if (c == '_' || c == '-' || c == '[' || c == ']') continue;
    result += c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  }
  return result;
}

/// All keys and all groups above them.
std::set<std::string_view> known_paths() {
  std::set<std::string_view> paths;
  for (const SchemaKey& key : schema())
    for (std::string_view path = key.path; !path.empty(); path = split_path(path).parent)
      paths.insert(path);
  return paths;
}

/// The edit distance, but 1 when `name` is the end of `known`, as `client_id` of
/// `mqttsn_client_id`, or its beginning, as `retry` of `retry_count`.
std::size_t distance(const std::string& name, const std::string& known) {
  constexpr std::size_t least_telling = 3;
  const bool is_part = name.size() >= least_telling && known != name &&
                       (known.ends_with(name) || known.starts_with(name));
  return is_part ? 1 : edit_distance(name, known);
}

std::string shown(std::string_view path) {
  return std::string(path.ends_with("[]") ? path.substr(0, path.size() - 2) : path);
}

/// Returns `robots[].` for a key in an element of that list, whose other keys alone can be meant;
/// empty for all other keys.
std::string_view list_of(std::string_view path) {
  constexpr std::string_view element = "[].";
  const std::size_t end = path.rfind(element);
  return end == path.npos ? std::string_view{} : path.substr(0, end + element.size());
}

/// ` Known in broker: client_id, uri`
std::string known_beside(std::string_view unknown_parent) {
  std::string names;
  for (const std::string_view path : known_paths()) {
    const Split known = split_path(path);
    if (known.parent == unknown_parent) names += (names.empty() ? "" : ", ") + shown(known.name);
  }
  const std::string group(unknown_parent.empty() ? "the file" : unknown_parent);
  return " Known in " + group + ": " + names;
}

}  // namespace

std::string suggestion(std::string_view unknown_path) {
  const Split unknown = split_path(unknown_path);
  const std::string name = plain(unknown.name);
  std::string_view best;
  // Of equally near names the one that needs fewer edits as a whole: `groups` for `group`.
  std::pair best_score(std::numeric_limits<std::size_t>::max(), std::size_t{0});
  for (const std::string_view path : known_paths()) {
    if (!path.starts_with(list_of(unknown_path))) continue;
    const Split known = split_path(path);
    const std::pair score(distance(name, plain(known.name)) +
                              (known.parent == unknown.parent ? 0 : elsewhere_penalty),
                          edit_distance(unknown.name.substr(0, longest_compared), known.name));
    if (score < best_score) {
      best_score = score;
      best = path;
    }
  }
  // If half of the name has to change, the suggestion is only a guess.
  const bool is_close = 2 * distance(name, plain(split_path(best).name)) < name.size();
  return "did you mean " + shown(best) + "?" + (is_close ? "" : known_beside(unknown.parent));
}

}  // namespace slamgw
