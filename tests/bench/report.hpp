// SPDX-License-Identifier: Apache-2.0
// The table on the terminal and results.json: runs, and budgets with measured values.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "tests/bench/load.hpp"

namespace slamgw::bench {

class Report {
 public:
  void add(const RunResult& run);
  /// Prints `ok` or `MISSED`; `unit` follows the numbers. `detail`: the absolute numbers behind.
  void budget_at_most(const std::string& what, double measured, double budget,
                      const std::string& unit, const std::string& detail = {});
  void budget_at_least(const std::string& what, double measured, double budget,
                       const std::string& unit, const std::string& detail = {});
  void write(const std::string& path) const;

 private:
  void budget(const std::string& what, double measured, const std::string& relation, double budget,
              bool is_kept, const std::string& unit, const std::string& detail);

  nlohmann::json runs_ = nlohmann::json::array();
  nlohmann::json budgets_ = nlohmann::json::array();
  std::string last_name_;
};

double median(std::vector<double> values);
/// Returns the median of `value(round)`.
template <class Round, class Value>
double median_of(const std::vector<Round>& rounds, Value&& value) {
  std::vector<double> values;
  for (const Round& round : rounds) values.push_back(value(round));
  return median(std::move(values));
}

}  // namespace slamgw::bench
