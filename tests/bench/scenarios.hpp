// SPDX-License-Identifier: Apache-2.0
// What is measured, in which order, and the budgets that it is held against.
#pragma once

#include "tests/bench/report.hpp"

namespace slamgw::bench {

void run_all(Report& report, unsigned rounds);

}  // namespace slamgw::bench
