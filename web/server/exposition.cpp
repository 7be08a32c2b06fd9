// SPDX-License-Identifier: Apache-2.0
#include "web/server/exposition.hpp"

#include <fmt/format.h>

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
  auto family = families_.find(name);
  if (family == families_.end()) {
    Family fresh{std::string(help), std::string(type_of(name, labels)), {}};
    family = families_.emplace(name, std::move(fresh)).first;
  }
  std::string& out = family->second.samples;
  out += name;
  if (!labels.empty()) {
    out += '{';
    for (const auto& [label, text] : labels) append_label(out, label, text);
    out += '}';
  }
  out += fmt::format(" {}\n", value);
}

std::string Exposition::text() const {
  std::string out;
  for (const auto& [name, family] : families_)
    out += fmt::format("# HELP {} {}\n# TYPE {} {}\n{}", name, family.help, name, family.type,
                       family.samples);
  return out;
}

}  // namespace slamgw::web
