// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/parse.hpp"

#include <algorithm>
#include <filesystem>

#include "daemon/config/checks.hpp"
#include "daemon/config/credentials.hpp"
#include "daemon/config/located_json.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/config/schema.hpp"
#include "daemon/config/tls_files.hpp"
#include "daemon/config/value.hpp"

namespace slamgw {
namespace {

/// Walks the tree along the schema.
class Reader {
 public:
  Reader(Config& config, std::map<std::string, int>& lines, FileContext& context)
      : config_(config), lines_(lines), context_(context) {}

  void read_root(const JsonNode& root) {
    if (root.value.is_object()) {
      read_members(root, {}, {});
    } else {
      add_problem(root, "syntax", "the configuration is not a group; write { ... } around it");
    }
  }

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
    const SchemaKey* key = find_key(row);
    const bool has_members = is_group(row);
    const bool has_elements = is_group(row + "[]");
    if (key == nullptr && !has_members && !has_elements) return report_unknown(node, path, row);
    lines_[path] = node.line;
    Value value(node, path, context_);
    if (has_elements) return read_elements(value, row + "[]");
    if (has_members && !node.value.is_object() && !(key != nullptr && value.is_null()))
      return value.not_allowed("a group of keys in braces { ... }");
    if (key != nullptr) key->read(value, config_);
    if (has_members) read_members(node, path, row);
  }

  void read_elements(Value list, const std::string& row) {
    list.list(
        [&](Value item) {
          lines_[item.path()] = item.node().line;
          if (!item.node().value.is_object())
            return item.not_allowed("a group of keys in braces { ... }");
          find_key(row)->read(item, config_);
          read_members(item.node(), item.path(), row);
        },
        "groups { ... }");
  }

  void report_unknown(const JsonNode& node, const std::string& path, const std::string& row) {
    if (node.key.find('.') != std::string::npos)
      return add_problem(
          node, path,
          "a dot in a key is not allowed; allowed: groups, like \"broker\": {\"uri\": ...}");
    add_problem(node, path, "unknown key; " + suggestion(row));
  }

  void add_problem(const JsonNode& node, const std::string& path, std::string text) {
    context_.problems.push_back({context_.file, node.line, path, std::move(text)});
  }

  Config& config_;
  std::map<std::string, int>& lines_;
  FileContext& context_;
};

void fill_defaults(Config& config, const Surroundings& surroundings) {
  if (config.gateway_id.empty()) config.gateway_id = gateway_id_of_host(surroundings.host_name);
  config.broker.gateway_id = config.gateway_id;
  if (config.broker.client_id.empty())
    config.broker.client_id = "slam-gateway-" + config.gateway_id;
}

void sort_by_line(Problems& problems, const std::string& file) {
  std::stable_sort(problems.begin(), problems.end(), [&file](const Problem& a, const Problem& b) {
    return std::pair(a.file != file, a.line) < std::pair(b.file != file, b.line);
  });
}

}  // namespace

ParseResult parse_config(std::string_view text, const std::string& file_name,
                         const Surroundings& surroundings, const Files& files) {
  ParseResult result;
  LocatedJson document = read_located_json(text, file_name);
  FileContext context{file_name, std::filesystem::path(file_name).parent_path().string(),
                      std::move(document.problems)};
  if (document.is_complete) {
    Reader(result.config, result.lines, context).read_root(document.root);
    fill_defaults(result.config, surroundings);
    const Located located{result.config, result.lines, context};
    check_relations(located);
    read_credentials(located, result.config.broker, surroundings, files);
    check_tls_files(located, files);
  }
  result.problems = std::move(context.problems);
  sort_by_line(result.problems, file_name);
  return result;
}

}  // namespace slamgw
