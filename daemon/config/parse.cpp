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

/// Walks the tree along the schema.
class Reader {
 public:
  explicit Reader(ParseResult& result) : result_(result) {}

  void read_root(const JsonNode& root) { read_members(root, {}, {}); }

 private:
  /// `path` is the key as shown (`robots[0].id`), `row` as in the schema (`robots[].id`).
  void read_members(const JsonNode& node, const std::string& path, const std::string& row) {
    for (const JsonNode& child : node.children) {
      const std::string dot = path.empty() ? "" : ".";
      read_key(child, path + dot + child.key, row + dot + child.key);
    }
  }

  void read_key(const JsonNode& node, const std::string& path, const std::string& row) {
    if (node.key.find_first_of(".[") != std::string::npos) return report_unknown(node, path, row);
    if (row == meaningless_group) return read_meaningless(node, path);
    const SchemaKey* key = find_key(row);
    const bool has_members = is_group(row);
    const bool has_elements = is_group(row + "[]");
    if (key == nullptr && !has_members && !has_elements) return report_unknown(node, path, row);
    Place& place = result_.places[path] = node.place;
    place.is_null = node.value.is_null();
    Value value(node, path, result_);
    if (has_elements) return read_elements(value, row + "[]");
    if (has_members && !node.value.is_object() && !(key != nullptr && value.is_null()))
      return value.not_allowed("a group of keys in braces { ... }", false);
    if (key != nullptr) key->read(value, result_.config);
    if (has_members) read_members(node, path, row);
  }

  void read_elements(Value list, const std::string& row) {
    list.list(
        [&](Value item) {
          result_.places[item.path()] = item.node().place;
          if (!item.node().value.is_object())
            return item.not_allowed("a group of keys in braces { ... }", false);
          find_key(row)->read(item, result_.config);
          read_members(item.node(), item.path(), row);
        },
        "groups { ... }");
  }

  void read_meaningless(const JsonNode& node, const std::string& path) {
    if (!node.value.is_object() || node.children.empty()) return add_notice(node, path);
    for (const JsonNode& child : node.children) add_notice(child, path + "." + child.key);
  }

  void add_notice(const JsonNode& node, const std::string& path) {
    result_.notices.push_back(
        {node.place.file, node.place.line, path,
         "has no meaning any more: gateways on one broker need only different "
         "values of gateway.id"});
  }

  void report_unknown(const JsonNode& node, const std::string& path, const std::string& row) {
    if (is_credential(node.key))
      return add_problem(node, path,
                         fmt::format("does not belong in this file, which others may read; put "
                                     "{{\"username\": \"...\", \"password\": \"...\"}} into "
                                     "{}credentials.json (mode 0600)",
                                     row.starts_with("web.") ? "web-" : ""));
    if (node.key.find('.') != std::string::npos)
      return add_problem(
          node, path,
          "a dot in a key is not allowed; allowed: groups, like \"broker\": {\"uri\": ...}");
    add_problem(node, path, "unknown key; " + suggestion(row));
  }

  void add_problem(const JsonNode& node, const std::string& path, std::string text) {
    result_.problems.push_back({node.place.file, node.place.line, path, std::move(text)});
  }

  static bool is_credential(std::string_view key) {
    constexpr std::string_view names[] = {"password", "passwd", "pass", "username", "user"};
    return std::find(std::begin(names), std::end(names), key) != std::end(names);
  }

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

void append(Problems& all, const Problems& more) {
  all.insert(all.end(), more.begin(), more.end());
}

/// The readable parts as one tree.
struct Tree {
  std::optional<JsonNode> root;  ///< nothing when no part can be read
  bool is_complete = true;       ///< whether all parts are in it
  Problems problems{};           ///< of each part by itself: a later part may overrule the value
  Problems notices{};            ///< likewise
  struct BanList {
    Place place;
    std::vector<std::string> entries;
  };
  std::vector<BanList> bans{};  ///< of each part; the last is in force
};

Tree read_tree(const std::vector<ConfigFile>& parts) {
  Tree tree;
  for (const ConfigFile& part : parts) {
    LocatedJson document = read_located_json(part.text, part.name);
    append(tree.problems, document.problems);
    if (!document.is_complete) {
      tree.is_complete = false;
    } else if (!document.root.value.is_object()) {
      tree.is_complete = false;
      tree.problems.push_back({part.name, document.root.place.line, "syntax",
                               "the configuration is not a group; write { ... } around it"});
    } else {
      ParseResult alone;
      Reader(alone).read_root(document.root);
      append(tree.problems, alone.problems);
      append(tree.notices, alone.notices);
      if (const auto place = alone.places.find("bans"); place != alone.places.end())
        tree.bans.push_back({place->second, alone.config.bans});
      if (tree.root)
        overlay(*tree.root, std::move(document.root));
      else
        tree.root = std::move(document.root);
    }
  }
  return tree;
}

/// Warns of bans that are not in force, because a later part has a list of its own.
void warn_of_overruled_bans(ParseResult& result, const Tree& tree) {
  const std::set<std::string> in_force(result.config.bans.begin(), result.config.bans.end());
  for (const Tree::BanList& list : tree.bans) {
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
  const Tree tree = read_tree(parts);
  if (tree.root) Reader(result).read_root(*tree.root);
  result.problems = tree.problems;
  result.notices = tree.notices;
  // An unreadable part may set keys that the others need; without it, checks would report them.
  if (tree.is_complete) {
    fill_defaults(result.config, environment);
    check_relations(result);
    if (environment.is_daemon) {
      warn_of_relations(result);
      warn_of_overruled_bans(result, tree);
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
  const Tree tree = read_tree({part});
  if (tree.root) Reader(result).read_root(*tree.root);
  result.problems = tree.problems;
  return result;
}

}  // namespace slamgw
