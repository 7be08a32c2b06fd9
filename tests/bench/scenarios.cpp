// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/scenarios.hpp"

#include <fmt/format.h>

#include <utility>

#include "tests/bench/bounds.hpp"
#include "tests/bench/swarm.hpp"
#include "tests/bench/world.hpp"

namespace slamgw::bench {
namespace {

RunResult by_paho(World& world, const std::string& name, const Load& load) {
  return Run(name, "paho", load, world.broker.port()).watch_paho();
}

RunResult by_paho_5(World& world, const std::string& name, const Load& load) {
  return Run(name, "paho 5", load, world.broker.port()).watch_paho(true);
}

/// The same load on all ways, within the same minute. `paho_5` sends what the gateway does: with
/// properties, by MQTT 5; it shows what of our cost is Paho's.
struct Round {
  RunResult gateway, raw, paho, paho_5;

  Round(World& world, Report& report, const std::string& name, const Load& load)
      : gateway(through_gateway(world, name, load)),
        raw(straight(world, name, load)),
        paho(by_paho(world, name, load)),
        paho_5(by_paho_5(world, name, load)) {
    for (const RunResult* run : {&gateway, &raw, &paho, &paho_5}) report.add(*run);
  }
};

void flat_out(World& world, Report& report, unsigned count, unsigned qos) {
  Load load;
  load.clients = 100;
  load.qos = qos;
  const std::string name = fmt::format("100 clients flat out, QoS {}", qos);
  std::vector<Round> rounds;
  for (unsigned i = 0; i < count; ++i) rounds.emplace_back(world, report, name, load);
  const auto per_second = [&](RunResult Round::*way) {
    return median_of(rounds, [&](const Round& round) { return (round.*way).per_second; });
  };
  const auto share = [&](RunResult Round::*floor) {
    return median_of(rounds, [&](const Round& round) {
      return 100 * round.gateway.per_second / (round.*floor).per_second;
    });
  };
  report.budget_at_least(
      name + ", throughput of bare Paho C++'s", share(&Round::paho), 85, "%",
      fmt::format("{:.0f}/s to {:.0f}/s; of the raw floor's {:.0f}/s: {:.0f} %; "
                  "of Paho's with the same properties, {:.0f}/s: {:.0f} %",
                  per_second(&Round::gateway), per_second(&Round::paho), per_second(&Round::raw),
                  share(&Round::raw), per_second(&Round::paho_5), share(&Round::paho_5)));
  const auto cpu = [&](RunResult Round::*way) {
    return median_of(rounds, [&](const Round& round) { return (round.*way).cpu_us; });
  };
  report.budget_at_most(
      name + ", CPU over bare Paho C++'s",
      median_of(rounds,
                [](const Round& round) { return round.gateway.cpu_us - round.paho.cpu_us; }),
      12, "us/message",
      fmt::format("{:.1f} us to {:.1f} us; Paho's with the same properties {:.1f} us",
                  cpu(&Round::gateway), cpu(&Round::paho), cpu(&Round::paho_5)));
}

void fixed_rate(World& world, Report& report, unsigned count) {
  Load load;
  load.pace = Pace::fixed_rate;
  load.clients = 1000;
  load.per_second = 5000;
  for (const unsigned qos : {1U, 0U}) {
    load.qos = qos;
    const std::string name = fmt::format("1000 clients x 5/s, QoS {}", qos);
    std::vector<Round> rounds;
    for (unsigned i = 0; i < count; ++i) rounds.emplace_back(world, report, name, load);
    if (qos == 0) continue;  // the budgets are for QoS 1
    const auto added = [&](const std::string& what, double Percentiles::*which, double budget) {
      const auto of = [&](RunResult Round::*way) {
        return median_of(rounds, [&](const Round& round) { return (round.*way).latency.*which; });
      };
      report.budget_at_most(
          name + ", latency added to the raw floor's, " + what,
          median_of(rounds,
                    [&](const Round& round) {
                      return round.gateway.latency.*which - round.raw.latency.*which;
                    }),
          budget, "ms",
          fmt::format("{:.3f} ms to {:.3f} ms", of(&Round::gateway), of(&Round::raw)));
    };
    added("p50", &Percentiles::p50_ms, 0.15);
    added("p99", &Percentiles::p99_ms, 0.5);
  }
}

/// In a daemon of its own, whose memory nothing before has touched.
void many_clients(Report& report) {
  World world;
  Load load;
  load.pace = Pace::fixed_rate;
  load.clients = 10;
  load.per_second = 5000;
  load.duration = std::chrono::seconds(8);
  const RunResult few = through_gateway(world, "10 clients x 500/s, QoS 1", load);
  report.add(few);

  load.clients = 10000;
  const double kib_before = static_cast<double>(usage_of(world.pid()).rss_kib);
  const std::string name = "10 000 clients x 0.5/s, QoS 1";
  double kib_idle = 0;
  const RunResult many = through_gateway(
      world, name, load, [&] { kib_idle = static_cast<double>(usage_of(world.pid()).rss_kib); });
  report.add(many);
  report.budget_at_most(name + ", lost", static_cast<double>(many.lost()), 0, "messages");
  report.budget_at_most(name + ", RSS", static_cast<double>(many.rss_kib) / 1024, 40, "MiB");
  report.budget_at_most(name + ", RSS for each idle client", (kib_idle - kib_before) / 10000, 3,
                        "KiB");
  report.budget_at_most("CPU per message at 10 000 clients, of that at 10",
                        many.cpu_us / few.cpu_us, 1.3, "times",
                        fmt::format("{:.1f} us to {:.1f} us", many.cpu_us, few.cpu_us));
}

void idle(Report& report) {
  World world;
  report.budget_at_most("idle, no clients, RSS",
                        static_cast<double>(usage_of(world.pid()).rss_kib) / 1024, 12, "MiB");
  Poller poller;
  Swarm swarm(world.sn_port(), 1000, poller, 0);
  swarm.connect_all(1);
  report.budget_at_most("CONNECT to CONNACK, p50, one at a time",
                        percentiles_of(swarm.connect_times()).p50_ms, 0.5, "ms");
  settle(world);
  const auto begin = Clock::now();
  const double cpu_before = usage_of(world.pid()).cpu_s;
  poller.wait(begin + std::chrono::seconds(20), [](std::uint64_t) {});
  const std::chrono::duration<double> took = Clock::now() - begin;
  report.budget_at_most("idle, 1000 clients, CPU",
                        100 * (usage_of(world.pid()).cpu_s - cpu_before) / took.count(), 0.1,
                        "% of a core");
}

void burst(Report& report) {
  World world;
  Load load;
  load.pace = Pace::at_once;
  load.clients = 5000;
  const RunResult run = through_gateway(world, "5000 datagrams at once, QoS 1", load);
  report.add(run);
  report.budget_at_most(run.name + ", lost end to end", static_cast<double>(run.lost()), 0,
                        "messages", fmt::format("{} repeated by the clients", run.repeats));
}

}  // namespace

void run_scenarios(Report& report, unsigned rounds, const std::string& only) {
  const auto is_wanted = [&](std::string_view name) { return only.empty() || only == name; };
  if (is_wanted("flat_out") || is_wanted("fixed_rate")) {
    World world;
    if (is_wanted("flat_out")) {
      for (const unsigned qos : {0U, 1U}) flat_out(world, report, rounds, qos);
    }
    if (is_wanted("fixed_rate")) fixed_rate(world, report, rounds);
  }
  if (is_wanted("many")) many_clients(report);
  if (is_wanted("idle")) idle(report);
  if (is_wanted("burst")) burst(report);
  if (is_wanted("traffic")) traffic_lines(report, rounds);
  if (is_wanted("start")) start_to_ready(report);
  if (is_wanted("backlog")) backlog(report);
  if (is_wanted("fairness")) fairness(report, rounds);
  if (is_wanted("ble")) ble_link(report);
  if (only == "memory") memory(report);  // minutes: by its name only
}

}  // namespace slamgw::bench
