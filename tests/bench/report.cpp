// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>

namespace slamgw::bench {
namespace {

/// Above this limit the generator, not the measured process, bounds the throughput.
constexpr double generator_limit = 0.9;

}  // namespace

void Report::add(const RunResult& run) {
  if (run.name != last_name_) {
    fmt::print("\n{}\n  {:<17}{:>9}{:>8}{:>6}{:>6}{:>5}{:>9}{:>9}{:>9}{:>8}{:>8}{:>6}{:>9}{:>5}\n",
               run.name, "path", "msg/s", "recv", "lost", "drop", "dup", "p50 ms", "p99 ms",
               "p999 ms", "max ms", "us/msg", "cs/m", "RSS KiB", "gen");
    last_name_ = run.name;
  }
  fmt::print(
      "  {:<17}{:>9.0f}{:>8}{:>6}{:>6}{:>5}{:>9.3f}{:>9.3f}{:>9.3f}{:>8.2f}{:>8.1f}{:>6.2f}{:>9}"
      "{:>4.0f}%{}\n",
      run.path, run.per_second, run.received, run.lost(), run.drops, run.duplicates,
      run.latency.p50_ms, run.latency.p99_ms, run.latency.p999_ms, run.latency.max_ms, run.cpu_us,
      run.context_switches, run.rss_kib, 100 * run.generator_cpu,
      run.generator_cpu > generator_limit ? "  generator-bound" : "");
  std::fflush(stdout);
  runs_.push_back({{"name", run.name},
                   {"path", run.path},
                   {"clients", run.load.clients},
                   {"qos", run.load.qos},
                   {"per_second", run.per_second},
                   {"sent", run.sent},
                   {"received", run.received},
                   {"lost", run.lost()},
                   {"dropped_by_kernel", run.drops},
                   {"duplicates", run.duplicates},
                   {"repeated_by_clients", run.repeats},
                   {"p50_ms", run.latency.p50_ms},
                   {"p99_ms", run.latency.p99_ms},
                   {"p999_ms", run.latency.p999_ms},
                   {"max_ms", run.latency.max_ms},
                   {"cpu_us_per_message", run.cpu_us},
                   {"context_switches_per_message", run.context_switches},
                   {"rss_kib", run.rss_kib},
                   {"generator_cpu", run.generator_cpu},
                   {"generator_bound", run.generator_cpu > generator_limit}});
}

void Report::budget_at_most(const std::string& what, double measured, double limit,
                            const std::string& unit, const std::string& detail) {
  budget(what, measured, "<=", limit, measured <= limit, unit, detail);
}

void Report::budget_at_least(const std::string& what, double measured, double limit,
                             const std::string& unit, const std::string& detail) {
  budget(what, measured, ">=", limit, measured >= limit, unit, detail);
}

void Report::budget(const std::string& what, double measured, const std::string& relation,
                    double limit, bool is_kept, const std::string& unit,
                    const std::string& detail) {
  const std::string line =
      fmt::format("{:<6} {}: {:.4g} {} (budget {} {:.4g}){}{}", is_kept ? "ok" : "MISSED", what,
                  measured, unit, relation, limit, detail.empty() ? "" : "; ", detail);
  fmt::print("{}\n", line);
  std::fflush(stdout);
  budgets_.push_back({{"what", what},
                      {"measured", measured},
                      {"budget", limit},
                      {"unit", unit},
                      {"kept", is_kept},
                      {"detail", detail}});
}

void Report::write(const std::string& path) const {
  std::ofstream(path) << nlohmann::json{{"runs", runs_}, {"budgets", budgets_}}.dump(2) << '\n';
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t middle = values.size() / 2;
  return values.size() % 2 == 1 ? values.at(middle) : (values.at(middle - 1) + values[middle]) / 2;
}

}  // namespace slamgw::bench
