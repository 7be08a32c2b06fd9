// SPDX-License-Identifier: Apache-2.0
// The I/O shell of the BLE side: the network behind a pty, and the run's beginning and end.
#pragma once

#include "simulation/options.hpp"

namespace slamgw::sim::ble {

/// Runs until all is sent or a signal comes; prints the summary. Returns the exit status.
int run_serial_side(const BleOptions& options);

}  // namespace slamgw::sim::ble
