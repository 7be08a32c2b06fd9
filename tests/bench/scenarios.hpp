// SPDX-License-Identifier: Apache-2.0
// What is measured, in which order, and the budgets that it is held against.
#pragma once

#include "tests/bench/report.hpp"

namespace slamgw::bench {

/// `only`: "flat_out", "fixed_rate", "many", "idle" or "burst"; all when empty.
void run_scenarios(Report& report, unsigned rounds, const std::string& only);

}  // namespace slamgw::bench
