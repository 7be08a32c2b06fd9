// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/loads.hpp"

#include <fmt/format.h>

#include <stdexcept>
#include <thread>

#include "tests/bench/echo_floor.hpp"
#include "tests/bench/swarm.hpp"

namespace slamgw::bench {
namespace {

double kib_of(const Target& target) {
  return static_cast<double>(usage_of(target.process).rss_kib);
}

constexpr std::size_t idle_clients = 1000;

/// Waits for the work that follows the last CONNECT in small steps, such as writing sessions.
void await_idleness(pid_t process) {
  constexpr std::chrono::seconds span{1}, limit{10};
  constexpr double at_rest_s = 0.001;
  for (const auto end = Clock::now() + limit; Clock::now() < end;) {
    const double before = usage_of(process).cpu_s;
    std::this_thread::sleep_for(span);
    if (usage_of(process).cpu_s - before < at_rest_s) return;
  }
}

void ping_for(std::chrono::seconds span, std::size_t clients, Swarm& swarm, Poller& poller) {
  const auto gap = std::chrono::nanoseconds(Swarm::keep_alive) / clients;
  const auto begin = Clock::now();
  for (auto due = begin; due < begin + span;) {
    for (; due <= Clock::now(); due += gap) swarm.ping_next();
    poller.wait(due, [&](std::uint64_t token) { swarm.on_readable(token); });
  }
}

}  // namespace

NamedLoad flat_out_load(const Plan& plan, unsigned qos) {
  return {fmt::format("100 clients flat out, QoS {}", qos),
          {.pace = Pace::flat_out, .clients = 100, .qos = qos, .duration = plan.span}};
}

NamedLoad steady_load(const Plan& plan, unsigned qos, Pace pace) {
  return {
      fmt::format("1000 clients x 5/s{}, QoS {}", pace == Pace::aligned ? ", aligned" : "", qos),
      {.pace = pace, .clients = 1000, .qos = qos, .per_second = 5000, .duration = plan.span}};
}

Idle look_at_idle(const Target& target, const Plan& plan) {
  Idle idle;
  target.settle();
  idle.kib_before = kib_of(target);
  Poller poller;
  Swarm swarm(target.gateway, idle_clients, poller, 0);
  swarm.connect_all(1);
  target.settle();
  await_idleness(target.process);
  idle.kib_each = (kib_of(target) - idle.kib_before) / idle_clients;
  const auto begin = Clock::now();
  const double cpu_before = usage_of(target.process).cpu_s;
  ping_for(plan.idle, idle_clients, swarm, poller);
  const std::chrono::duration<double> took = Clock::now() - begin;
  idle.cpu_percent = 100 * (usage_of(target.process).cpu_s - cpu_before) / took.count();
  poller.wait(Clock::now() + std::chrono::milliseconds(100),
              [&](std::uint64_t token) { swarm.on_readable(token); });
  idle.unanswered = swarm.pings_unanswered();
  return idle;
}

double look_at_echo(const Plan& plan) {
  EchoFloor floor;
  Poller poller;
  Swarm swarm(floor.address(), idle_clients, poller, 0);
  const double before = floor.cpu_s();
  ping_for(plan.idle, idle_clients, swarm, poller);
  return 100 * (floor.cpu_s() - before) / std::chrono::duration<double>(plan.idle).count();
}

Connects look_at_connects(const Target& target, std::size_t at_once) {
  constexpr std::size_t clients = 5000;
  target.settle();
  Poller poller;
  const double cpu_before = usage_of(target.process).cpu_s;
  Swarm swarm(target.gateway, clients, poller, 0);
  swarm.connect_all(at_once);
  target.settle();  // waits for presence and sessions on disk
  const double cpu_s = usage_of(target.process).cpu_s - cpu_before;
  return {cpu_s * 1e6 / clients, percentiles_of(swarm.connect_times())};
}

void compare(const Target& target, Report& report, const Plan& plan) {
  for (const NamedLoad& each :
       {flat_out_load(plan, 0), flat_out_load(plan, 1), steady_load(plan, 1, Pace::fixed_rate),
        steady_load(plan, 1, Pace::aligned)}) {
    for (unsigned i = 0; i < plan.rounds; ++i) {
      report.add(through_gateway(target, each.name, each.load));
      report.add(straight(target, each.name, each.load));
    }
  }
  // Before the connects are measured, because a gateway may keep state of those clients.
  const Idle idle = look_at_idle(target, plan);
  const Connects connects = look_at_connects(target, 1);
  fmt::print("\nCONNECT to CONNACK, one at a time: p50 {:.3f} ms, p99 {:.3f} ms\n",
             connects.latency.p50_ms, connects.latency.p99_ms);
  fmt::print("1000 idle clients with a keep-alive of 60 s: {} PINGREQ unanswered\n",
             idle.unanswered);
  if (target.process == 0) return;
  fmt::print("CONNECT and REGISTER: {:.0f} us of CPU for each client\n", connects.cpu_us);
  fmt::print("1000 idle clients: {:.3f} % of a core\n", idle.cpu_percent);
}

}  // namespace slamgw::bench
