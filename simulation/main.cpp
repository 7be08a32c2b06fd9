// SPDX-License-Identifier: Apache-2.0
// slam-gateway-sim: simulated robots on a simulated mesh, for people without hardware. Only
// chooses the side; see README.md.
#include <fcntl.h>

#include <cerrno>
#include <cstring>
#include <iostream>

#include "simulation/ble/serial_side.hpp"
#include "simulation/options.hpp"
#include "simulation/thread/fleet.hpp"

namespace {

using namespace slamgw::sim;

int run(const CommandLine& command) {
  if (const int* status = std::get_if<int>(&command)) return *status;
  if (const auto* thread = std::get_if<ThreadOptions>(&command)) return sn::run_fleet(*thread);
  return ble::run_serial_side(std::get<BleOptions>(command));
}

}  // namespace

int main(int argc, char** argv) {
  for (int number = 0; number <= 2; ++number)  // otherwise a socket gets a closed one's number
    if (fcntl(number, F_GETFD) < 0) open("/dev/null", number == 0 ? O_WRONLY : O_RDONLY);
  const int status = run(parse_command_line(argc, argv));
  if (std::cout.flush()) return status;
  std::cerr << "slam-gateway-sim: standard output: " << std::strerror(errno) << '\n';
  return 1;
}
