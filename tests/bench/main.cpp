// SPDX-License-Identifier: Apache-2.0
// slam-gateway-bench [--rounds N] [--quick] [--only PART] [--out FILE]: the built daemon between
// MQTT-SN clients and a real Mosquitto on loopback, beside three floors. With --gateway and
// --broker the same load meets any other MQTT-SN gateway. Run by `./dev bench`. Being slow is
// not a failure.
#include <fmt/format.h>
#include <sys/prctl.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <thread>

#include "tests/bench/loads.hpp"
#include "tests/bench/scenarios.hpp"

namespace {

using namespace slamgw::bench;

/// 10 000 clients have a socket each.
void allow_many_files() {
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

/// Waits until the process uses no processor; without a process, a fixed time. Its steps end
/// neither just over one second after the last message nor just over two: Paho does not read for
/// 0.1 s then (docs/performance.md), which would distort a load that begins there.
void settle(pid_t process) {
  constexpr std::chrono::milliseconds span{900};
  constexpr double at_rest_s = 0.018;
  double used = 0;
  do {
    const double before = usage_of(process).cpu_s;
    std::this_thread::sleep_for(span);
    used = usage_of(process).cpu_s - before;
  } while (used > at_rest_s);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App options("slam-gateway-bench");
  Plan plan;
  bool is_quick = false;
  std::string only, gateway, broker;
  std::string out = "results.json";
  pid_t process = 0;
  auto* rounds =
      options.add_option("--rounds", plan.rounds, "repetitions; budgets are judged by the median");
  options.add_flag("--quick", is_quick, "one short round: orders of magnitude")->excludes(rounds);
  options.add_option("--out", out, "where the results go, as JSON");
  options.add_option("--only", only, "one part")
      ->check(CLI::IsMember(std::vector<std::string>(part_names.begin(), part_names.end())));
  auto* other = options.add_option("--gateway", gateway, "HOST:PORT of another MQTT-SN gateway");
  auto* behind =
      options.add_option("--broker", broker, "HOST:PORT of the broker behind it")->needs(other);
  other->needs(behind);
  options.add_option("--process", process, "its process id on this host, for CPU and memory")
      ->needs(other);
  CLI11_PARSE(options, argc, argv);
  if (is_quick) plan = Plan::quick();
  allow_many_files();
  prctl(PR_SET_TIMERSLACK, 1UL);  // waits of a fraction of a millisecond end in time
  try {
    Report report;
    if (gateway.empty()) {
      run_scenarios(report, plan, only);
    } else {
      compare({"gateway", parse_address(gateway, SOCK_DGRAM), parse_address(broker, SOCK_STREAM),
               process, [process] { settle(process); }},
              report, plan);
    }
    report.write(out);
    fmt::print("\nwritten: {}\n", out);
  } catch (const std::exception& error) {
    fmt::print(stderr, "slam-gateway-bench: {}\n", error.what());
    return 1;
  }
  return 0;
}
