// SPDX-License-Identifier: Apache-2.0
// One value of the configuration on its way into a setting: checks its type and range, and reports
// a mistake together with the allowed values. Used by the schema's rows.
#pragma once

#include <algorithm>
#include <chrono>
#include <concepts>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "daemon/config/located_json.hpp"
#include "daemon/config/parse_result.hpp"

namespace slamgw {

/// Which texts are good, and the words for them that complete "allowed: ".
struct TextRule {
  bool (*is_good)(std::string_view text);
  std::string_view allowed;
};

/// A setting changes only when the value is good.
class Value {
 public:
  /// `json`: the value at `path` in `document`.
  Value(const LocatedJson& document, const Json& json, std::string path, ParseResult& result)
      : document_(document), json_(json), path_(std::move(path)), result_(result) {}

  bool is_null() const { return json_.is_null(); }
  const std::string& path() const { return path_; }
  const Json& json() const { return json_; }
  Place place() const { return {document_.file, document_.line_of(path_), is_null()}; }

  void boolean(bool& out);
  void number(double& out, double min, double max);
  void seconds(std::chrono::seconds& out, std::uint64_t min, std::uint64_t max);
  void text(std::string& out, const TextRule& rule);
  /// `null` is the same as leaving the key out.
  void text(std::optional<std::string>& out, const TextRule& rule);
  /// Like `text`, but the value never shows in a problem.
  void secret(std::optional<std::string>& out, const TextRule& rule);
  /// Relative paths become relative to the file; `keyword` stays as it is.
  void file_path(std::string& out, std::string_view keyword = {});
  void file_path(std::optional<std::string>& out);
  /// A mesh address: a number, or text like "0x0100".
  void address(std::uint16_t& out, std::uint16_t min, std::uint16_t max);
  void address(std::optional<std::uint16_t>& out, std::uint16_t min, std::uint16_t max);
  void list(const std::function<void(Value)>& each, std::string_view allowed);
  void texts(std::vector<std::string>& out, const TextRule& rule);
  /// Adds this element to `list`; reports it instead when the list already has it.
  template <class T>
  void add_once(std::vector<T>& list, const T& element) {
    if (std::find(list.begin(), list.end(), element) != list.end())
      return problem("is in this list already; each entry once is allowed");
    list.push_back(element);
  }

  template <std::unsigned_integral T>
  void integer(T& out, std::uint64_t min, std::uint64_t max) {
    if (const auto number = whole_number(min, max)) out = static_cast<T>(*number);
  }

  template <class E>
  void one_of(E& out, std::initializer_list<std::pair<std::string_view, E>> names) {
    const auto found = std::find_if(names.begin(), names.end(), [this](const auto& name) {
      return string() && *string() == name.first;
    });
    if (found != names.end()) {
      out = found->second;
      return;
    }
    std::string allowed;
    for (const auto& [name, value] : names)
      allowed += (allowed.empty() ? "\"" : ", \"") + std::string(name) + "\"";
    not_allowed(allowed, string() != nullptr);
  }

  /// Reports "<description of the value> is not allowed; allowed: <allowed>". A value of a wrong
  /// type must not show: it may be a secret that belongs into a file.
  void not_allowed(std::string_view allowed, bool is_shown);
  void problem(std::string text);

 private:
  std::optional<std::uint64_t> whole_number(std::uint64_t min, std::uint64_t max);
  bool is_good(const TextRule& rule) const { return string() && rule.is_good(*string()); }
  const std::string* string() const { return json_.get_ptr<const std::string*>(); }
  std::string absolute(const std::string& path) const;

  const LocatedJson& document_;
  const Json& json_;
  std::string path_;
  ParseResult& result_;
};

}  // namespace slamgw
