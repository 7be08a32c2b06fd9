// SPDX-License-Identifier: Apache-2.0
// The options of the command line. Names, defaults and ranges are a promise to users (README.md).
// The two sides read these structs; only command_line.cpp fills them.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "simulation/ble/firmware.hpp"
#include "simulation/bytes.hpp"
#include "simulation/robot_body.hpp"
#include "simulation/time.hpp"

namespace slamgw::sim {

/// The path between a robot and its gateway, hop by hop from the robot; one value applies to all
/// further hops. Losses add to --loss. Empty: --loss and the mesh's own times.
struct HopOptions {
  std::vector<double> loss;      ///< 0..1, of each transmission
  std::vector<double> delay_ms;  ///< mean; each transmission takes 0.5 to 1.5 times that

  bool is_given() const { return !loss.empty() || !delay_ms.empty(); }
  double loss_of(unsigned hop) const { return value_of(loss, hop); }
  double delay_ms_of(unsigned hop) const { return value_of(delay_ms, hop); }

 private:
  static double value_of(const std::vector<double>& values, unsigned hop) {
    return values.empty() ? 0 : values[std::min<std::size_t>(hop, values.size() - 1)];
  }
};

/// Options with the same meaning on both meshes.
struct RobotOptions {
  unsigned robots = 3;
  double rate_hz = 5;
  std::uint64_t messages = 0;  ///< updates per robot; 0: until SIGINT or SIGTERM
  std::uint64_t seed = 1;
  std::string id_prefix = "robot";
  double loss = 0;  ///< 0..1
  bool obeys = false;
  double linger_s = 0;  ///< after the last update, for late commands
  std::string record;   ///< a file, or nothing
  std::string trace;    ///< a file, or nothing
  HopOptions hop;
  BodySettings body;

  bool is_recorded() const { return !record.empty() || !trace.empty(); }

  std::string id_of(unsigned number) const { return id_prefix + std::to_string(number); }
  std::optional<std::uint64_t> limit() const {
    return messages == 0 ? std::nullopt : std::optional(messages);
  }
  Duration period() const {
    return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(1 / rate_hz));
  }
  Duration linger() const {
    return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(linger_s));
  }
};

struct ThreadOptions {
  RobotOptions common;
  unsigned hops = 1;
  std::string host;
  std::string port;
  int qos = 1;  ///< -1: without a session, on pre-defined topic ids
  std::string topic_prefix = "ntnu-slam";
  bool hears = false;  ///< robots subscribe to each other's updates
  double duplicate = 0;
  double reorder = 0;
  unsigned delay_ms = 0;
  unsigned keep_alive_s = 60;
  bool is_clean = true;
  unsigned sleep_s = 0;       ///< 0: robots stay awake
  double roam_s = 0;          ///< 0: robots keep their addresses
  double will_updates_s = 0;  ///< 0: robots keep their wills
  double vanish = 0;          ///< part of the robots
  double retry_s = 8;
  unsigned outstanding = 4;
  double give_up_s = 60;  ///< exit 1 when no robot is connected after this time; 0: never
};

struct BleOptions {
  RobotOptions common;
  std::vector<std::string> ttys{""};  ///< of each board; all hear the same robots
  std::vector<double> board_loss;     ///< of each board's messages, both ways; besides `loss`
  std::vector<int> board_level_db;    ///< difference of each board from the usual signal level
  std::vector<double> board_fade_s;   ///< period in which each board fades out and in; 0: never
  const ble::Firmware* firmware = &ble::firmware_3_1_0;  ///< of board and robots
  unsigned hops = 1;
  bool is_acknowledged = false;
  bool is_numbered = false;  ///< acknowledged ones have a transaction number
  bool is_unicast = false;
  bool has_segment_timing = false;
  std::optional<ble::OnBusy> on_busy;
  unsigned bearer_interval_ms = 0;  ///< 0: a node can transmit at any time
  unsigned baud = 0;                ///< of the boards' serial lines; 0: octets take no time
  bool has_board_storage = false;   ///< else the board forgets its tables, as the stock one does
  bool is_configured = false;
  Bytes net_key;  ///< 16 octets
  Bytes app_key;  ///< 16 octets
  bool is_unprovisioned = false;
  Bytes uuid_prefix;  ///< at most 12 octets
  Bytes static_oob;   ///< 16 octets, or none
  bool has_heartbeats = false;
  unsigned robot_reach = 65535;  ///< robots stand in a row; each hears this many on either side
  std::string state;             ///< a file, or none

  /// With a start and a stop bit.
  Duration octet_time() const {
    return baud == 0 ? Duration{} : Duration{std::chrono::seconds{10}} / baud;
  }
};

/// The simulation, or the exit status if the program ends at once (`--help`, wrong arguments).
using CommandLine = std::variant<ThreadOptions, BleOptions, int>;

/// Prints help or errors; returns status 0 after `--help`, 2 for wrong arguments.
CommandLine parse_command_line(int argc, const char* const* argv);

}  // namespace slamgw::sim
