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

void append_labels(std::string& out, const Labels& labels) {
  if (labels.empty()) return;
  out += '{';
  for (const auto& [label, text] : labels) append_label(out, label, text);
  out += '}';
}

}  // namespace

void Exposition::add(std::string_view name, std::string_view help, const Labels& labels,
                     double value) {
  const std::string_view type = type_of(name, labels);
  if (value >= 0 || type != "counter") add_to(name, help, type, {{"", labels, value}});
}

void Exposition::add_histogram(std::string_view name, std::string_view help, const Labels& labels,
                               const Histogram& histogram) {
  std::vector<Sample> samples;
  const auto add_bucket = [&](std::string bound, double count) {
    Labels bounded = labels;
    bounded.emplace_back("le", std::move(bound));
    samples.push_back({"_bucket", std::move(bounded), count});
  };
  for (const auto& [bound, count] : histogram.at_most) add_bucket(fmt::to_string(bound), count);
  add_bucket("+Inf", histogram.count);
  samples.push_back({"_sum", labels, histogram.sum});
  samples.push_back({"_count", labels, histogram.count});
  add_to(name, help, "histogram", samples);
}

void Exposition::add_to(std::string_view name, std::string_view help, std::string_view type,
                        const std::vector<Sample>& samples) {
  if (bytes_ > max_bytes) {
    left_out_ += samples.size();
    return;
  }
  auto family = families_.find(name);
  if (family == families_.end())
    family = families_.emplace(name, Family{std::string(help), std::string(type), {}}).first;
  std::string& out = family->second.samples;
  const std::size_t before = out.size();
  for (const auto& [ending, labels, value] : samples) {
    out.append(name).append(ending);
    append_labels(out, labels);
    fmt::format_to(std::back_inserter(out), " {}\n", value);
  }
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
