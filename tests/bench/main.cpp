// SPDX-License-Identifier: Apache-2.0
// slam-gateway-bench [--rounds N] [--only PART] [--out FILE]: the built daemon between MQTT-SN
// clients and a real Mosquitto on loopback, beside two floors. Run by `./dev bench`. Being slow is
// no failure.
#include <fmt/format.h>
#include <sys/prctl.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>

#include "tests/bench/scenarios.hpp"

namespace {

/// 10 000 clients have a socket each.
void allow_many_files() {
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App options("slam-gateway-bench");
  unsigned rounds = 3;
  std::string only;
  std::string out = "results.json";
  options.add_option("--rounds", rounds, "repetitions; budgets are judged by the median");
  options.add_option("--out", out, "where the results go, as JSON");
  options.add_option("--only", only, "one part")
      ->check(CLI::IsMember(std::vector<std::string>(slamgw::bench::part_names.begin(),
                                                     slamgw::bench::part_names.end())));
  CLI11_PARSE(options, argc, argv);
  allow_many_files();
  prctl(PR_SET_TIMERSLACK, 1UL);  // waits of a fraction of a millisecond end in time
  try {
    slamgw::bench::Report report;
    slamgw::bench::run_scenarios(report, std::max(1U, rounds), only);
    report.write(out);
    fmt::print("\nwritten: {}\n", out);
  } catch (const std::exception& error) {
    fmt::print(stderr, "slam-gateway-bench: {}\n", error.what());
    return 1;
  }
  return 0;
}
