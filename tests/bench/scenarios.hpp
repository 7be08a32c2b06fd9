// SPDX-License-Identifier: Apache-2.0
// The measured parts, in their order, and their budgets.
#pragma once

#include <array>

#include "tests/bench/plan.hpp"
#include "tests/bench/report.hpp"

namespace slamgw::bench {

inline constexpr std::array part_names{"flat_out", "fixed_rate", "many",    "idle",
                                       "connect",  "burst",      "traffic", "start",
                                       "backlog",  "fairness",   "ble",     "memory"};

/// `only`: one of `part_names`; all but `memory` when empty.
void run_scenarios(Report& report, const Plan& plan, const std::string& only);

}  // namespace slamgw::bench
