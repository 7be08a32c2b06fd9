// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl: arguments to a request, the daemon's answer to text or JSON. Exit status: 0
// done, 1 failed, 2 wrong arguments.
#include <unistd.h>

#include <cstdlib>
#include <iostream>

#include "ctl/command_line.hpp"
#include "ctl/connection.hpp"
#include "ctl/show.hpp"
#include "daemon/control/wire.hpp"

namespace {

using namespace slamgw::ctl;

constexpr int exit_failed = 1;
constexpr std::chrono::seconds answer_patience{10};
/// The daemon tells a command's outcome within 30 s, and gives up on it 5 s later.
constexpr std::chrono::seconds outcome_patience{45};

Show make_show() {
  const bool with_colour = isatty(STDOUT_FILENO) == 1 && std::getenv("NO_COLOR") == nullptr;
  return Show(with_colour, std::chrono::system_clock::now());
}

std::string text_of(const Order& order, const nlohmann::json& result) {
  if (order.json) return slamgw::control::to_line(result);
  switch (order.answer) {
    case Answer::status: return make_show().status(result);
    case Answer::robots: return make_show().robots(result);
    case Answer::watch: return make_show().event(result);
    case Answer::outcome: return make_show().outcome(result);
    case Answer::text: return slamgw::control::to_line(result);
  }
  return {};
}

int run(const Order& order) {
  Connection connection(order.socket);
  const bool is_send = order.answer == Answer::outcome;
  const auto result = connection.ask(order.request, is_send ? outcome_patience : answer_patience);
  if (order.answer == Answer::watch)
    while (true) std::cout << text_of(order, connection.next_event()) << std::flush;
  std::cout << text_of(order, result);
  return is_send && result.value("outcome", "") != "delivered" ? exit_failed : 0;
}

}  // namespace

int main(int argc, char** argv) {
  const auto parsed = parse_command_line(argc, argv);
  if (const auto* exit = std::get_if<Exit>(&parsed)) return exit->status;
  try {
    return run(std::get<Order>(parsed));
  } catch (const std::exception& error) {
    std::cout << std::flush;
    std::cerr << "slam-gatewayctl: " << error.what() << '\n';
    return exit_failed;
  }
}
