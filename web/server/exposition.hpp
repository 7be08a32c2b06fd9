// SPDX-License-Identifier: Apache-2.0
// Prometheus's text format, version 0.0.4
// (https://prometheus.io/docs/instrumenting/exposition_formats/). Pure.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace slamgw::web {

using Labels = std::vector<std::pair<std::string_view, std::string>>;

struct Histogram {
  std::vector<std::pair<double, double>> at_most;  ///< bounds, rising, and their cumulative counts
  double count = 0;
  double sum = 0;
};

class Exposition {
 public:
  /// Enough for twenty thousand robots. The bound is needed because names come from the broker.
  static constexpr std::size_t max_bytes = 24 << 20;

  /// Keeps the samples of one name together, as the format requires. The type follows from the name
  /// and the labels: `_total` is a counter, a label `quantile` a summary, the rest are gauges.
  /// Samples that do not fit are left out and counted. A counter cannot be negative: left out.
  void add(std::string_view name, std::string_view help, const Labels& labels, double value);
  /// Adds `_bucket` with a last label `le`, `_sum` and `_count`.
  void add_histogram(std::string_view name, std::string_view help, const Labels& labels,
                     const Histogram& histogram);
  std::uint64_t left_out() const { return left_out_; }
  std::string text() const;

 private:
  struct Family {
    std::string help;
    std::string type;
    std::string samples;
  };
  struct Sample {
    std::string_view ending;  ///< the name's end
    Labels labels;
    double value = 0;
  };
  void add_to(std::string_view name, std::string_view help, std::string_view type,
              const std::vector<Sample>& samples);

  std::map<std::string, Family, std::less<>> families_;
  std::size_t bytes_ = 0;
  std::uint64_t left_out_ = 0;
};

}  // namespace slamgw::web
