// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl doctor`: examines the way of a message from radio to broker, step by step, and
// gives a remedy for each fault. Facts are gathered first; judging them does no I/O.
#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "ctl/connection.hpp"
#include "ctl/host/installation.hpp"
#include "daemon/config/parse.hpp"

namespace slamgw::ctl {

enum class Health : std::uint8_t { well, warning, problem, unknown };

struct Finding {
  std::string step;  ///< "broker", "thread: multicast"
  Health health = Health::well;
  std::string detail;  ///< what was found
  std::string remedy;  ///< what to do; empty when all is well
};

/// This host's facts about one network interface.
struct InterfaceFacts {
  std::string name;
  bool is_up = false;
  std::vector<std::string> addresses;         ///< numeric, IPv4 and IPv6
  std::vector<std::string> multicast_groups;  ///< joined by any program
};

/// Programs on this host that may be the broker.
struct LocalBrokers {
  /// Files that Mosquitto may open; the lowest limit if several run.
  std::optional<std::uint64_t> mosquitto_files;
  bool has_ejabberd = false;
  bool has_others = false;  ///< NATS, or a program in Erlang, as RabbitMQ is
};

/// This host's facts about the Bluetooth controller that bluetooth-meshd should have.
struct BluetoothFacts {
  bool has_controller = false;
  bool is_blocked = false;    ///< by rfkill
  std::string meshd_version;  ///< the version of the package bluez-meshd; empty: not installed
  bool is_bluetoothd_active = false;
  bool is_meshd_active = false;
  std::string meshd_command;  ///< as bluetooth-mesh.service starts it
};

struct HostFacts {
  ParseResult configuration;
  /// Keys of the configuration whose files this user may not read.
  std::set<std::string> closed_keys;
  nlohmann::json status;       ///< the daemon's; null when it does not answer
  std::string status_failure;  ///< why the daemon does not answer
  bool is_running = true;      ///< a program listens at the daemon's socket
  bool is_silent = false;      ///< that program answers nothing
  nlohmann::json fleet;        ///< the daemon's answer to `fleet`; null when there is none
  std::string own_version;
  std::string host_name;
  LocalBrokers brokers;
  std::vector<InterfaceFacts> interfaces;
  BluetoothFacts bluetooth;                ///< only for ble_mesh.radio "bluez"
  std::optional<bool> is_search_answered;  ///< a SEARCHGW of our own; nothing: not tried
  /// A port of mqttsn.listen that another program uses; checked when the daemon does not run.
  std::optional<std::uint16_t> taken_port;
  std::optional<bool> is_clock_synchronised;
  std::optional<std::uint64_t> state_free_bytes;  ///< on the disk of store.directory
};

/// Returns the findings in the order of the way from radio to broker.
std::vector<Finding> examine(const HostFacts& facts);

struct RobotFacts {
  nlohmann::json robots;        ///< the daemon's answer to `robots`
  nlohmann::json nodes;         ///< its answer to `ble nodes`; null without a BLE mesh
  std::string refusal;          ///< the journal's newest line about a refusal; may be empty
  nlohmann::json fleet_robots;  ///< the robots of its answer to `fleet`; null when there are none
};

/// Returns the known facts about one robot, and why it is silent.
std::vector<Finding> examine_robot(const std::string& robot, const RobotFacts& facts,
                                   const ParseResult& configuration);

nlohmann::json to_json(const std::vector<Finding>& findings);
/// Returns a line for each finding, with its remedy below.
std::string to_text(const std::vector<Finding>& findings);
/// Returns whether any finding is a problem.
bool has_problem(const std::vector<Finding>& findings);

/// Takes up to some seconds. Changes nothing on this host.
HostFacts gather_facts(const Installation& installation, const std::string& socket);
/// Asks the daemon, and the journal of the last day.
RobotFacts gather_robot_facts(const std::string& robot, Connection& daemon);

}  // namespace slamgw::ctl
