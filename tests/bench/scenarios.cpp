// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/scenarios.hpp"

#include <fmt/format.h>

#include <thread>
#include <utility>

#include "tests/bench/bounds.hpp"
#include "tests/bench/loads.hpp"
#include "tests/bench/swarm.hpp"

namespace slamgw::bench {
namespace {

/// The daemon with either MQTT client library.
struct BothClients {
  World paho;
  World mosquitto{with_mosquitto};
};

RunResult by_floor(World& world, const NamedLoad& load, const std::string& path,
                   const char* program, bool has_properties) {
  return Run(load.name, path, load.load, world.broker_address()).watch(program, has_properties);
}

/// The same load on all paths, within the same minute. `paho 5` and `libmosquitto` send the
/// gateway's messages, by MQTT 5 and with properties: they show the library's share of the cost.
struct Round {
  RunResult paho, mosquitto, raw, paho_floor, paho_5_floor, mosquitto_floor;

  Round(BothClients& pair, Report& report, const NamedLoad& load)
      : paho(through_gateway(pair.paho.target(), load.name, load.load)),
        mosquitto(through_gateway(pair.mosquitto.target(), load.name, load.load)),
        raw(straight(pair.paho.target(), load.name, load.load)),
        paho_floor(by_floor(pair.paho, load, "paho", SLAMGW_BENCH_PAHO, false)),
        paho_5_floor(by_floor(pair.paho, load, "paho 5", SLAMGW_BENCH_PAHO, true)),
        mosquitto_floor(by_floor(pair.paho, load, "libmosquitto", SLAMGW_BENCH_MOSQUITTO, true)) {
    for (const RunResult* run :
         {&paho, &mosquitto, &raw, &paho_floor, &paho_5_floor, &mosquitto_floor})
      report.add(*run);
  }
};

class Rounds {
 public:
  Rounds(BothClients& pair, Report& report, const NamedLoad& load, unsigned count) {
    for (unsigned i = 0; i < count; ++i) rounds_.emplace_back(pair, report, load);
  }
  /// Returns the median of `value(round)`.
  template <class Value>
  double median(Value&& value) const {
    return median_of(rounds_, value);
  }
  double per_second(RunResult Round::*path) const {
    return median([&](const Round& round) { return (round.*path).per_second; });
  }
  double cpu_us(RunResult Round::*path) const {
    return median([&](const Round& round) { return (round.*path).cpu_us; });
  }
  double share(RunResult Round::*path, RunResult Round::*floor) const {
    return median([&](const Round& round) {
      return 100 * (round.*path).per_second / (round.*floor).per_second;
    });
  }
  double latency(RunResult Round::*path, double Percentiles::*which) const {
    return median([&](const Round& round) { return (round.*path).latency.*which; });
  }

 private:
  std::vector<Round> rounds_;
};

void flat_out(BothClients& pair, Report& report, const Plan& plan, unsigned qos) {
  const NamedLoad load = flat_out_load(plan, qos);
  const Rounds rounds(pair, report, load, plan.rounds);
  report.budget_at_least(
      load.name + ", throughput of bare Paho C++'s", rounds.share(&Round::paho, &Round::paho_floor),
      85, "%",
      fmt::format("{:.0f}/s to {:.0f}/s; of the raw floor's {:.0f}/s: {:.0f} %; "
                  "of Paho's with the same properties, {:.0f}/s: {:.0f} %",
                  rounds.per_second(&Round::paho), rounds.per_second(&Round::paho_floor),
                  rounds.per_second(&Round::raw), rounds.share(&Round::paho, &Round::raw),
                  rounds.per_second(&Round::paho_5_floor),
                  rounds.share(&Round::paho, &Round::paho_5_floor)));
  report.budget_at_most(
      load.name + ", CPU over bare Paho C++'s",
      rounds.median([](const Round& round) { return round.paho.cpu_us - round.paho_floor.cpu_us; }),
      12, "us/message",
      fmt::format("{:.1f} us to {:.1f} us; Paho's with the same properties {:.1f} us",
                  rounds.cpu_us(&Round::paho), rounds.cpu_us(&Round::paho_floor),
                  rounds.cpu_us(&Round::paho_5_floor)));
  const double least_per_second = qos == 0 ? 45000 : 35000;
  report.budget_at_least(
      load.name + ", `mosquitto`, throughput", rounds.per_second(&Round::mosquitto),
      least_per_second, "/s",
      fmt::format("bare libmosquitto {:.0f}/s", rounds.per_second(&Round::mosquitto_floor)));
  report.budget_at_most(
      load.name + ", `mosquitto`, CPU", rounds.cpu_us(&Round::mosquitto), qos == 0 ? 8 : 20,
      "us/message",
      fmt::format("bare libmosquitto {:.1f} us", rounds.cpu_us(&Round::mosquitto_floor)));
}

void fixed_rate(BothClients& pair, Report& report, const Plan& plan) {
  for (const auto& [qos, pace] : {std::pair{1U, Pace::fixed_rate}, std::pair{1U, Pace::aligned},
                                  std::pair{0U, Pace::fixed_rate}}) {
    const NamedLoad load = steady_load(plan, qos, pace);
    const bool has_budgets = qos == 1 && pace == Pace::fixed_rate;
    const Rounds rounds(pair, report, load, has_budgets ? plan.rounds : 1);
    if (!has_budgets) continue;
    const auto added = [&](const std::string& what, double Percentiles::*which, double budget) {
      report.budget_at_most(
          load.name + ", latency added to the raw floor's, " + what,
          rounds.median([&](const Round& round) {
            return round.paho.latency.*which - round.raw.latency.*which;
          }),
          budget, "ms",
          fmt::format("{:.3f} ms to {:.3f} ms", rounds.latency(&Round::paho, which),
                      rounds.latency(&Round::raw, which)));
    };
    added("p50", &Percentiles::p50_ms, 0.15);
    added("p99", &Percentiles::p99_ms, 0.5);
    const std::string with = load.name + ", `mosquitto`, ";
    report.budget_at_most(with + "p50", rounds.latency(&Round::mosquitto, &Percentiles::p50_ms),
                          0.115, "ms");
    report.budget_at_most(with + "p99", rounds.latency(&Round::mosquitto, &Percentiles::p99_ms), 1,
                          "ms");
    report.budget_at_most(with + "CPU", rounds.cpu_us(&Round::mosquitto), 50, "us/message");
  }
}

/// In a daemon of its own, whose memory no earlier part has used.
void many_clients(Report& report, const Plan& plan, World&& world) {
  Load load;
  load.pace = Pace::fixed_rate;
  load.clients = 10;
  load.per_second = 5000;
  load.duration = 2 * plan.span;
  const RunResult few = through_gateway(world.target(), "10 clients x 500/s, QoS 1", load);
  report.add(few);

  load.clients = 10000;
  const double kib_before = static_cast<double>(usage_of(world.pid()).rss_kib);
  const std::string name = "10 000 clients x 0.5/s, QoS 1";
  double kib_idle = 0;
  const RunResult many = through_gateway(world.target(), name, load, [&] {
    kib_idle = static_cast<double>(usage_of(world.pid()).rss_kib);
  });
  report.add(many);
  const std::string path = " (" + world.path + ")";
  report.budget_at_most(name + ", lost" + path, static_cast<double>(many.lost()), 0, "messages");
  report.budget_at_most(name + ", RSS" + path, static_cast<double>(many.rss_kib) / 1024, 40, "MiB");
  report.budget_at_most(name + ", RSS for each idle client" + path, (kib_idle - kib_before) / 10000,
                        3, "KiB");
  report.budget_at_most("CPU per message at 10 000 clients, of that at 10" + path,
                        many.cpu_us / few.cpu_us, 1.3, "times",
                        fmt::format("{:.1f} us to {:.1f} us", many.cpu_us, few.cpu_us));
}

void idle(Report& report, const Plan& plan, World&& world, double base_mib, double echo_percent) {
  const Idle idle = look_at_idle(world.target(), plan);
  const std::string path = " (" + world.path + ")";
  report.budget_at_most("idle, no clients, RSS" + path, idle.kib_before / 1024, base_mib, "MiB");
  report.budget_at_most("idle, 1000 clients with a keep-alive of 60 s, CPU" + path,
                        idle.cpu_percent, 0.15, "% of a core",
                        fmt::format("a socket that only answers {:.3f} %", echo_percent));
  report.budget_at_most("idle, 1000 clients, RSS for each" + path, idle.kib_each, 3, "KiB");
  report.budget_at_most("idle, PINGREQ without an answer" + path,
                        static_cast<double>(idle.unanswered), 0, "");
}

void connects(Report& report, World&& world) {
  // In its first five seconds, the broker returns each presence that the daemon publishes.
  constexpr std::chrono::seconds until_alone{6};
  std::this_thread::sleep_for(until_alone);
  const std::string path = " (" + world.path + ")";
  const Connects alone = look_at_connects(world.target(), 1);
  report.budget_at_most("CONNECT to CONNACK, p50, one at a time" + path, alone.latency.p50_ms, 0.5,
                        "ms");
  report.budget_at_most("CONNECT and REGISTER, one at a time, CPU" + path, alone.cpu_us, 100,
                        "us/client");
  const Connects many = look_at_connects(world.target(), connects_at_once);
  report.budget_at_most(
      fmt::format("CONNECT and REGISTER, {} at a time, CPU{}", connects_at_once, path), many.cpu_us,
      100, "us/client", fmt::format("CONNECT to CONNACK p50 {:.2f} ms", many.latency.p50_ms));
}

void burst(Report& report) {
  World world;
  Load load;
  load.pace = Pace::at_once;
  load.clients = 5000;
  const RunResult run = through_gateway(world.target(), "5000 datagrams at once, QoS 1", load);
  report.add(run);
  report.budget_at_most(run.name + ", lost end to end", static_cast<double>(run.lost()), 0,
                        "messages", fmt::format("{} repeated by the clients", run.repeats));
}

}  // namespace

void run_scenarios(Report& report, const Plan& plan, const std::string& only) {
  const auto is_wanted = [&](std::string_view name) { return only.empty() || only == name; };
  if (is_wanted("flat_out") || is_wanted("fixed_rate")) {
    BothClients pair;
    if (is_wanted("flat_out")) {
      for (const unsigned qos : {0U, 1U}) flat_out(pair, report, plan, qos);
    }
    if (is_wanted("fixed_rate")) fixed_rate(pair, report, plan);
  }
  if (is_wanted("many")) {
    many_clients(report, plan, World());
    many_clients(report, plan, World(with_mosquitto));
  }
  if (is_wanted("idle")) {
    const double echo_percent = look_at_echo(plan);
    idle(report, plan, World(), 12, echo_percent);
    idle(report, plan, World(with_mosquitto), 9, echo_percent);
  }
  if (is_wanted("connect")) {
    connects(report, World());
    connects(report, World(with_mosquitto));
  }
  if (is_wanted("burst")) burst(report);
  if (is_wanted("traffic")) traffic_lines(report, plan);
  if (is_wanted("start")) start_to_ready(report);
  if (is_wanted("backlog")) backlog(report);
  if (is_wanted("fairness")) {
    fairness(report, plan, World());
    fairness(report, plan, World(with_mosquitto));
  }
  if (is_wanted("ble")) ble_link(report);
  if (only == "memory") memory(report);  // takes minutes, so only when named
}

}  // namespace slamgw::bench
