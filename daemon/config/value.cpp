// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/value.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "daemon/config/rules.hpp"
#include "daemon/core/parse_number.hpp"

namespace slamgw {
namespace {

constexpr std::size_t longest_echo = 40;

/// Describes the value for "... is not allowed". Shows only short texts, quoted as JSON, and no
/// text or number unless `is_shown`.
std::string description(const Json& value, bool is_shown) {
  switch (value.type()) {
    case Json::value_t::object: return "a group in braces";
    case Json::value_t::array: return value.empty() ? "an empty list" : "a list";
    case Json::value_t::string:
      if (value.get_ref<const std::string&>().empty()) return "an empty text";
      if (value.get_ref<const std::string&>().size() > longest_echo || !is_shown)
        return "this text";
      return value.dump();
    case Json::value_t::null:
    case Json::value_t::boolean: return value.dump();
    case Json::value_t::number_integer:
    case Json::value_t::number_unsigned:
    case Json::value_t::number_float: return is_shown ? value.dump() : "this number";
    case Json::value_t::binary:
    case Json::value_t::discarded: break;  // never in a parsed text
  }
  return "this";
}

/// Refuses the content of a file in place of its path: JSON, or lines.
bool is_path(std::string_view text) {
  return !text.empty() && !text.starts_with('{') &&
         std::ranges::none_of(text, [](unsigned char c) { return c < 0x20 || c == 0x7f; });
}

std::optional<unsigned> parse_hex(std::string_view text) {
  if (!text.starts_with("0x") && !text.starts_with("0X")) return std::nullopt;
  return parse_number<unsigned>(text.substr(2), 16);
}

}  // namespace

void Value::boolean(bool& out) {
  if (json_.is_boolean()) {
    out = json_.get<bool>();
  } else {
    not_allowed("true or false", false);
  }
}

void Value::number(double& out, double min, double max) {
  const bool is_number = json_.is_number();
  const double number = is_number ? json_.get<double>() : 0;
  if (is_number && number >= min && number <= max) {
    out = number;
  } else {
    not_allowed(fmt::format("a number from {} to {}", min, max), is_number);
  }
}

void Value::seconds(std::chrono::seconds& out, std::uint64_t min, std::uint64_t max) {
  if (const auto number = whole_number(min, max)) out = std::chrono::seconds(*number);
}

void Value::text(std::string& out, const TextRule& rule) {
  if (is_good(rule)) {
    out = *string();
  } else {
    not_allowed(rule.allowed, string() != nullptr);
  }
}

void Value::text(std::optional<std::string>& out, const TextRule& rule) {
  if (is_null()) {
    out.reset();
  } else if (is_good(rule)) {
    out = *string();
  } else {
    not_allowed(fmt::format("{}, or null", rule.allowed), string() != nullptr);
  }
}

void Value::secret(std::optional<std::string>& out, const TextRule& rule) {
  result_.secrets.insert(path_);
  if (is_null() || is_good(rule)) return text(out, rule);
  problem(fmt::format("this value (not shown: it is secret) is not allowed; allowed: {}, or null",
                      rule.allowed));
}

void Value::file_path(std::string& out, std::string_view keyword) {
  if (string() == nullptr || !is_path(*string())) {
    not_allowed(keyword.empty() ? "the path of a file" : fmt::format("a path, or \"{}\"", keyword),
                false);
  } else {
    out = *string() == keyword ? *string() : absolute(*string());
  }
}

void Value::file_path(std::optional<std::string>& out) {
  if (is_null()) return out.reset();
  if (string() == nullptr || !is_path(*string()))
    return not_allowed("the path of a file, or null", false);
  out = absolute(*string());
}

void Value::address(std::uint16_t& out, std::uint16_t min, std::uint16_t max) {
  std::optional<std::uint64_t> number;
  if (json_.is_number_unsigned()) number = json_.get<std::uint64_t>();
  if (string() != nullptr) number = parse_hex(*string());
  if (number && *number >= min && *number <= max) {
    out = static_cast<std::uint16_t>(*number);
  } else {
    not_allowed(fmt::format("an address from \"{:#06x}\" to \"{:#06x}\"", min, max), true);
  }
}

void Value::address(std::optional<std::uint16_t>& out, std::uint16_t min, std::uint16_t max) {
  if (is_null()) return out.reset();
  std::uint16_t read = 0;
  address(read, min, max);
  if (read != 0) out = read;
}

void Value::list(const std::function<void(Value)>& each, std::string_view allowed) {
  if (!json_.is_array()) return not_allowed(fmt::format("a list [...] of {}", allowed), false);
  for (std::size_t i = 0; i < json_.size(); ++i)
    each(Value(document_, json_[i], fmt::format("{}[{}]", path_, i), result_));
}

void Value::texts(std::vector<std::string>& out, const TextRule& rule) {
  if (json_.is_array()) out.clear();
  list(
      [&](Value item) {
        std::string read;
        item.text(read, rule);
        if (read.empty())
          out.push_back(read);  // already reported; later checks must not also see an empty list
        else
          item.add_once(out, read);
      },
      rule.allowed);
}

void Value::not_allowed(std::string_view allowed, bool is_shown) {
  problem(fmt::format("{} is not allowed; allowed: {}", description(json_, is_shown), allowed));
}

void Value::problem(std::string text) {
  result_.problems.push_back({document_.file, document_.line_of(path_), path_, std::move(text)});
}

std::optional<std::uint64_t> Value::whole_number(std::uint64_t min, std::uint64_t max) {
  if (json_.is_number_unsigned()) {
    const auto number = json_.get<std::uint64_t>();
    if (number >= min && number <= max) return number;
  }
  not_allowed(fmt::format("a whole number from {} to {}", min, max), json_.is_number());
  return std::nullopt;
}

std::string Value::absolute(const std::string& path) const {
  return (std::filesystem::path(result_.file).parent_path() / path).lexically_normal().string();
}

}  // namespace slamgw
