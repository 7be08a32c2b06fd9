// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl: turns arguments into a command, and performs it. Exit status: 0 done, 1 failed,
// 2 wrong arguments.
#include <unistd.h>

#include <exception>
#include <iostream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "ctl/command_line.hpp"
#include "ctl/terminal.hpp"
#include "daemon/core/utf8.hpp"
#include "daemon/observability/standard_output.hpp"

namespace {

/// Escapes characters that hide or deceive. Keeps line ends, because each problem is a line.
std::string printable_lines(const std::string& text) {
  std::istringstream lines(text);
  std::string out;
  for (std::string line; std::getline(lines, line);) out += slamgw::escape_unprintable(line) + '\n';
  return out;
}

int perform(int argc, char** argv) {
  using namespace slamgw::ctl;
  try {
    const auto parsed = parse_command_line(argc, argv);
    if (const auto* exit = std::get_if<Exit>(&parsed)) return exit->status;
    const Order& order = std::get<Order>(parsed);
    if (!order.ask) return order.perform(order);
    Connection daemon(order.socket);
    return order.ask(daemon, order);
  } catch (const std::ios_base::failure&) {  // of standard output: the caller says why
  } catch (const std::exception& error) {
    std::cout.exceptions(std::ios::goodbit);
    std::cout << std::flush;
    std::cerr << fit_to_terminal("slam-gatewayctl: " + printable_lines(error.what()),
                                 STDERR_FILENO);
  }
  return exit_failed;
}

}  // namespace

int main(int argc, char** argv) {
  slamgw::open_standard_descriptors();
  std::cout.exceptions(std::ios::badbit);  // ends `watch`, too
  return slamgw::end_output("slam-gatewayctl", perform(argc, argv));
}
