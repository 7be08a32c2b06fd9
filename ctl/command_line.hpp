// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl's arguments as a request to the daemon.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <variant>

namespace slamgw::ctl {

/// How the answer is shown.
enum class Answer : std::uint8_t { status, robots, watch, outcome, scan, nodes, node, done };

struct Order {
  std::string socket = "/run/slam-gateway/control.sock";
  bool json = false;
  Answer answer = Answer::status;
  nlohmann::json request;
  std::string file;  ///< whose text goes with the request as `text`; empty: none
};

struct Exit {
  int status = 0;
};

/// Prints help, the version, or what is wrong with the arguments (status 2) itself.
std::variant<Order, Exit> parse_command_line(int argc, const char* const* argv);

}  // namespace slamgw::ctl
