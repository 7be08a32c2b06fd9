// SPDX-License-Identifier: Apache-2.0
// slam-gateway-sim: simulated robots on a simulated mesh, for people without hardware. Only
// chooses the side; see README.md.
#include "simulation/ble/serial_side.hpp"
#include "simulation/options.hpp"
#include "simulation/thread/fleet.hpp"

int main(int argc, char** argv) {
  using namespace slamgw::sim;
  const CommandLine command = parse_command_line(argc, argv);
  if (const int* status = std::get_if<int>(&command)) return *status;
  if (const auto* thread = std::get_if<ThreadOptions>(&command)) return sn::run_fleet(*thread);
  return ble::run_serial_side(std::get<BleOptions>(command));
}
