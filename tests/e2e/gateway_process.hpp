// SPDX-License-Identifier: Apache-2.0
// The daemon and the simulator as a user runs them: built programs, files, signals.
#pragma once

#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "tests/support/child_process.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {

/// slam-gatewayd with a configuration of its own in a directory of its own.
class GatewayProcess {
 public:
  /// `configuration` is completed with a control socket, a store directory, an MQTT-SN port on
  /// loopback and, when it names no gateway, the id `test`.
  explicit GatewayProcess(nlohmann::json configuration);

  GatewayProcess(const GatewayProcess&) = delete;
  GatewayProcess& operator=(const GatewayProcess&) = delete;

  /// `launcher`: a program, and its arguments, that becomes the daemon.
  void start(const std::vector<std::string>& launcher = {});
  /// Writes a configuration changed by `change`, for the next start.
  void configure(const std::function<void(nlohmann::json&)>& change);
  /// SIGHUP with such a configuration.
  void reload(const std::function<void(nlohmann::json&)>& change);
  std::string log() const;
  bool logs(const std::string& text) const { return log().find(text) != std::string::npos; }
  ChildProcess& process() { return *process_; }
  /// `slam-gatewayctl --json COMMAND...`; null when it fails.
  nlohmann::json ctl(const std::vector<std::string>& command) const;

  std::string mqttsn_address() const;
  /// The gateway that serves the robot, by `slam-gatewayctl fleet` of this one; empty: none.
  std::string place_in_fleet(const std::string& robot) const;
  std::string tty() const { return directory_ / "board"; }
  std::string operator/(std::string_view name) const { return directory_ / name; }

 private:
  TempDir directory_;
  std::uint16_t mqttsn_port_;
  std::unique_ptr<ChildProcess> process_;
};

/// Runs a program to its end.
struct Finished {
  std::optional<int> status;
  std::string out;
  std::string err;
};
Finished run_program(const std::vector<std::string>& arguments);

/// A running `slam-gateway-sim`.
class SimulatorProcess {
 public:
  explicit SimulatorProcess(const std::vector<std::string>& arguments);
  /// Waits for its end; the JSON object of its last line.
  nlohmann::json report();
  ChildProcess& process() { return *process_; }
  std::string errors() const;

 private:
  TempDir directory_;
  std::unique_ptr<ChildProcess> process_;
};

}  // namespace slamgw::test
