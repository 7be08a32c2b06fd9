// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/parse.hpp"

#include "daemon/config/located_json.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>
#include <string_view>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <set>

#include "daemon/config/checks.hpp"
#include "daemon/config/credentials.hpp"
#include "daemon/config/key_file.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/config/schema.hpp"
#include "daemon/core/bans.hpp"

namespace slamgw {
namespace {

/// A group of older configurations. Its keys are allowed with any value and have no effect.
constexpr std::string_view meaningless_group = "fleet";

/// Reads the keys of one part along the schema. They override those of the parts before it.
class Reader {
 public:
  Reader(const LocatedJson& document, ParseResult& result) : document_(document), result_(result) {}

  void read_root() { read_members(document_.root, {}, {}); }

 private:
  /// `path` is the key as shown (`robots[0].id`), `row` as in the schema (`robots[].id`).
  void read_members(const Json& group, const std::string& path, const std::string& row) {
    const std::string shown = path.empty() ? path : path + ".";
    const std::string known = row.empty() ? row : row + ".";
    for (const auto& [key, json] : group.items())
      read_key(key, Value(document_, json, shown + key, result_), known + key);
  }

  void read_key(const std::string& name, Value value, const std::string& row) {
    if (name.find_first_of(".[") != std::string::npos) return report_unknown(name, value, row);
    if (row == meaningless_group) return read_meaningless(value);
    const SchemaKey* key = find_key(row);
    const bool has_members = is_group(row);
    const bool has_elements = is_group(row + "[]");
    if (key == nullptr && !has_members && !has_elements) return report_unknown(name, value, row);
    take_place(value);
    if (has_elements) return read_elements(value, row + "[]");
    if (has_members && !value.json().is_object() && !(key != nullptr && value.is_null()))
      return value.not_allowed("a group of keys in braces { ... }", false);
    if (key != nullptr) key->read(value, result_.config);
    if (has_members) read_members(value.json(), value.path(), row);
  }

  /// Joins groups of several parts, which keep their first place. Any other value replaces that of
  /// an earlier part, with all that is below it.
  void take_place(const Value& value) {
    const auto [at, is_new] = result_.places.try_emplace(value.path(), value.place());
    if (is_new || (value.json().is_object() && !at->second.is_null)) return;
    at->second = value.place();
    std::erase_if(result_.places, [&path = value.path()](const auto& entry) {
      return entry.first.starts_with(path + ".") || entry.first.starts_with(path + "[");
    });
  }

  void read_elements(Value list, const std::string& row) {
    if (list.json().is_array()) find_key(row)->read(list, result_.config);
    list.list(
        [&](Value item) {
          result_.places[item.path()] = item.place();
          if (!item.json().is_object())
            return item.not_allowed("a group of keys in braces { ... }", false);
          find_key(row)->read(item, result_.config);
          read_members(item.json(), item.path(), row);
        },
        "groups { ... }");
  }

  void read_meaningless(const Value& group) {
    if (!group.json().is_object() || group.json().empty()) return add_notice(group.path());
    for (const auto& member : group.json().items()) add_notice(group.path() + "." + member.key());
  }

  void add_notice(const std::string& path) {
    result_.notices.push_back(
        {document_.file, document_.line_of(path), path,
         "has no meaning any more: gateways on one broker need only different "
         "values of gateway.id"});
  }

  static void report_unknown(const std::string& name, Value value, const std::string& row) {
    if (is_credential(name))
      return value.problem(fmt::format(
          "does not belong in this file, which others may read; put {{\"username\": \"...\", "
          "\"password\": \"...\"}} into {}credentials.json (mode 0600)",
          row.starts_with("web.") ? "web-" : ""));
    if (name.find('.') != std::string::npos)
      return value.problem(
          "a dot in a key is not allowed; allowed: groups, like \"broker\": {\"uri\": ...}");
    value.problem("unknown key; " + suggestion(row));
  }

  static bool is_credential(std::string_view key) {
    constexpr std::string_view names[] = {"password", "passwd", "pass", "username", "user"};
    return std::find(std::begin(names), std::end(names), key) != std::end(names);
  }

  const LocatedJson& document_;
  ParseResult& result_;
};

void fill_defaults(Config& config, const Environment& environment) {
  if (config.gateway_id.empty()) config.gateway_id = gateway_id_of_host(environment.host_name);
  config.broker.gateway_id = config.gateway_id;
  if (config.broker.client_id.empty())
    config.broker.client_id = default_client_id(config.gateway_id);
}

/// Sorts by file in the order of reading, and by line. Files that the configuration names are last.
void sort_by_place(Problems& problems, const std::vector<ConfigFile>& parts) {
  const auto rank = [&parts](const Problem& problem) {
    return std::find_if(parts.begin(), parts.end(),
                        [&](const ConfigFile& part) { return part.name == problem.file; }) -
           parts.begin();
  };
  std::stable_sort(problems.begin(), problems.end(), [&rank](const Problem& a, const Problem& b) {
    return std::pair(rank(a), a.line) < std::pair(rank(b), b.line);
  });
}

/// Returns false when the part cannot be read.
bool read_part(ParseResult& result, const ConfigFile& part) {
  const LocatedJson document = read_located_json(part.text, part.name);
  result.problems.insert(result.problems.end(), document.problems.begin(), document.problems.end());
  if (!document.is_complete) return false;
  if (document.root.is_object()) {
    Reader(document, result).read_root();
    return true;
  }
  result.problems.push_back({part.name, document.line, "syntax",
                             "the configuration is not a group; write { ... } around it"});
  return false;
}

/// The list of bans in one part; the last is in force.
struct BanList {
  Place place;
  std::vector<std::string> entries;
};

/// Warns of bans that are not in force, because a later part has a list of its own.
void warn_of_overruled_bans(ParseResult& result, const std::vector<BanList>& lists) {
  const std::set<std::string> in_force(result.config.bans.begin(), result.config.bans.end());
  for (const BanList& list : lists) {
    std::vector<std::string> lost = list.entries;
    std::erase_if(lost, [&](const std::string& entry) {
      const auto is_it = std::bind_front(Bans::are_same, entry);
      return in_force.contains(entry) || std::ranges::any_of(in_force, is_it);
    });
    if (lost.empty()) continue;
    result.warnings.push_back(
        {list.place.file, list.place.line, "bans",
         fmt::format("does not ban {}{}, because {} replaces this list; write all bans there, or "
                     "remove these here",
                     lost.front(),
                     lost.size() == 1 ? "" : fmt::format(" and {} more", lost.size() - 1),
                     result.places.at("bans").file)});
  }
}

}  // namespace

ParseResult parse_config(const std::vector<ConfigFile>& parts, const Environment& environment,
                         const Files& files) {
  ParseResult result;
  result.file = parts.front().name;
  bool is_complete = true;
  std::vector<BanList> bans;
  for (const ConfigFile& part : parts) {
    is_complete = read_part(result, part) && is_complete;
    const auto place = result.places.find("bans");
    if (place != result.places.end() && place->second.file == part.name)
      bans.push_back({place->second, result.config.bans});
  }
  // An unreadable part may set keys that the others need; without it, checks would report them.
  if (is_complete) {
    fill_defaults(result.config, environment);
    check_relations(result);
    if (environment.is_daemon) {
      warn_of_relations(result);
      warn_of_overruled_bans(result, bans);
      read_credentials(result, environment, files);
      read_robot_keys(result, files);
      check_tls_files(result, files);
    }
  }
  sort_by_place(result.problems, parts);
  return result;
}

ParseResult parse_keys(const ConfigFile& part) {
  ParseResult result;
  result.file = part.name;
  read_part(result, part);
  return result;
}

}  // namespace slamgw
