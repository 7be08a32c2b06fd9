// SPDX-License-Identifier: Apache-2.0
// Parses slam-gatewayctl's arguments into a command: one that the daemon answers
// (daemon_commands.cpp), or a task on this host (host_commands.cpp).
#pragma once

#include <cstdint>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <variant>

#include "ctl/connection.hpp"
#include "ctl/show.hpp"
#include "daemon/config/io/load.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace CLI {
class App;
}

namespace slamgw::ctl {

inline constexpr int exit_failed = 1;

/// A command with its arguments. The group that it belongs to leaves the other members alone.
struct Order {
  std::string socket = "/run/slam-gateway/control.sock";
  bool json = false;
  std::string robot;  ///< or an entry of `bans`; empty: all robots, or not for a robot
  std::string file;   ///< to read or to write
  bool is_confirmed = false;

  // For commands that the daemon answers:
  /// Carries the command out, and returns the exit status; null for a task on this host.
  int (*ask)(Connection& daemon, const Order& order) = nullptr;
  nlohmann::json request;
  /// Makes the text of an answer for people; null where `ask` makes it.
  std::string (*text)(const nlohmann::json& answer, const Screen& screen) = nullptr;
  std::chrono::seconds patience = answer_patience;
  std::uint64_t count = 1;

  // For tasks that slam-gatewayctl performs by itself, on the gateway's host:
  int (*perform)(const Order& order) = nullptr;
  std::string configuration = service_configuration;
  /// Asks the daemon at `socket`, which may not be this host's service, for its configuration.
  bool is_by_socket = false;
  std::uint64_t minutes = 1;  ///< for check
  std::string broker;         ///< for replay; empty: the configuration's
  std::string user;           ///< for replay, at the broker; empty: the daemon's
  double speed = 1;           ///< for replay
};

struct Exit {
  int status = 0;
};

/// Prints help, the version, or a fault in the arguments (status 2) itself.
std::variant<Order, Exit> parse_command_line(int argc, const char* const* argv);

/// Add the commands of both groups to the command line. Their arguments go into `order`.
void add_daemon_commands(CLI::App& app, Order& order);
void add_host_commands(CLI::App& app, Order& order);

/// Parses the PAYLOAD of `send`: with `is_hex`, pairs of hex digits. Otherwise `cmd` takes `X,Y` in
/// centimetres and gets two little-endian int16 (docs/topics.md); other types get the text itself.
/// The error says what is allowed.
Result<Bytes, std::string> parse_payload(std::string_view type, std::string_view text, bool is_hex);

/// Opens a file that a command reads. Throws Failure.
std::ifstream open_file(const std::string& path);
/// Warns when the robot was never heard: its name may be mistyped, and a watch would stay silent.
void warn_of_unheard(Connection& daemon, const std::string& robot);

}  // namespace slamgw::ctl
