// SPDX-License-Identifier: Apache-2.0
#include "web/server/exposition.hpp"

#include <fmt/format.h>

#include <iterator>

namespace slamgw::web {
namespace {

void append_label(std::string& out, std::string_view name, std::string_view value) {
  out.append(out.back() == '{' ? "" : ",").append(name).append("=\"");
  for (const char c : value) {
    if (c == '\n') {
      out += "\\n";
      continue;
    }
    if (c == '\\' || c == '"') out += '\\';
    out += c;
  }
  out += '"';
}

std::string_view type_of(std::string_view name, const Labels& labels) {
  if (name.ends_with("_total")) return "counter";
  return !labels.empty() && labels.back().first == "quantile" ? "summary" : "gauge";
}

}  // namespace

void Exposition::add(std::string_view name, std::string_view help, const Labels& labels,
                     double value) {
  if (bytes_ > max_bytes) {
    ++left_out_;
    return;
  }
  auto family = families_.find(name);
  if (family == families_.end()) {
    Family fresh{std::string(help), std::string(type_of(name, labels)), {}};
    family = families_.emplace(name, std::move(fresh)).first;
  }
  std::string& out = family->second.samples;
  const std::size_t before = out.size();
  out += name;
  if (!labels.empty()) {
    out += '{';
    for (const auto& [label, text] : labels) append_label(out, label, text);
    out += '}';
  }
  fmt::format_to(std::back_inserter(out), " {}\n", value);
  bytes_ += out.size() - before;
}

std::string Exposition::text() const {
  std::string out;
  out.reserve(bytes_ + families_.size() * 256);
  for (const auto& [name, family] : families_)
    fmt::format_to(std::back_inserter(out), "# HELP {} {}\n# TYPE {} {}\n{}", name, family.help,
                   name, family.type, family.samples);
  return out;
}

}  // namespace slamgw::web
