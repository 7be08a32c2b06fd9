// SPDX-License-Identifier: Apache-2.0
// The parts of the benchmark beside throughput and latency: start, backlog, fairness, and the cost
// of the serial line and of log lines.
#pragma once

#include "tests/bench/plan.hpp"
#include "tests/bench/report.hpp"
#include "tests/bench/world.hpp"

namespace slamgw::bench {

void traffic_lines(Report& report, const Plan& plan);
void start_to_ready(Report& report);
void backlog(Report& report);
/// How much a flood of one client delays the others.
void fairness(Report& report, const Plan& plan, World&& world);
void ble_link(Report& report);
/// A million connects and 100 000 topics; takes minutes.
void memory(Report& report);

}  // namespace slamgw::bench
