// SPDX-License-Identifier: Apache-2.0
// The loads that every gateway can be put under, ours and others.
#pragma once

#include <string>
#include <vector>

#include "tests/bench/plan.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/world.hpp"

namespace slamgw::bench {

struct NamedLoad {
  std::string name;
  Load load;
};

/// 100 clients that send as fast as they can.
NamedLoad flat_out_load(const Plan& plan, unsigned qos);
/// 1000 clients that send five messages a second, one after the other or all at once.
NamedLoad steady_load(const Plan& plan, unsigned qos, Pace pace);

struct Idle {
  double cpu_percent = 0;  ///< of one core
  double kib_before = 0;   ///< RSS without clients
  double kib_each = 0;     ///< RSS of a client
  std::uint64_t unanswered = 0;
};
/// 1000 clients that send only PINGREQ, each once in its keep-alive of 60 s.
Idle look_at_idle(const Target& target, const Plan& plan);
/// The same pings to a socket that only answers them; % of one core.
double look_at_echo(const Plan& plan);

struct Connects {
  double cpu_us = 0;    ///< for each client: CONNECT and REGISTER, and their consequences
  Percentiles latency;  ///< from CONNECT to CONNACK
};
/// CONNECT and REGISTER of 5000 clients.
Connects look_at_connects(const Target& target, std::size_t at_once);

/// `--gateway`: all of these, and the raw floor beside them, `plan.rounds` times.
void compare(const Target& target, Report& report, const Plan& plan);

}  // namespace slamgw::bench
