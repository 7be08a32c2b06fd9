// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the Thread side: a UDP socket and a timer for each robot's Client, and the run's
// beginning and end. All in one io_context, on one thread.
#pragma once

#include "simulation/options.hpp"

namespace slamgw::sim::sn {

/// Runs until all is sent or a signal comes; prints the summary. Returns the exit status.
int run_fleet(const ThreadOptions& options);

}  // namespace slamgw::sim::sn
