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
  /// Writes such a configuration and sends SIGHUP.
  void reload(const std::function<void(nlohmann::json&)>& change);
  std::string log() const;
  bool logs(const std::string& text) const { return log().find(text) != std::string::npos; }
  ChildProcess& process() { return *process_; }
  /// Runs `slam-gatewayctl --json COMMAND...`. Returns null when it fails.
  nlohmann::json ctl(const std::vector<std::string>& command) const;

  std::string mqttsn_address() const;
  /// Returns the gateway that serves the robot by `slam-gatewayctl fleet`; empty: none.
  std::string place_in_fleet(const std::string& robot) const;
  std::string tty() const { return directory_ / "board"; }
  std::string operator/(std::string_view name) const { return directory_ / name; }

 private:
  TempDir directory_;
  std::uint16_t mqttsn_port_;
  std::unique_ptr<ChildProcess> process_;
};

/// The end of a program; no status if it ran longer than allowed.
struct Finished {
  std::optional<int> status;
  std::string out;
  std::string err;
};
Finished run_program(const std::vector<std::string>& arguments,
                     std::chrono::milliseconds limit = patience);

/// A running `slam-gateway-sim`.
class SimulatorProcess {
 public:
  explicit SimulatorProcess(const std::vector<std::string>& arguments);
  /// Waits for the exit and returns the JSON object of the last line.
  nlohmann::json report();
  ChildProcess& process() { return *process_; }
  std::string errors() const;

 private:
  TempDir directory_;
  std::unique_ptr<ChildProcess> process_;
};

}  // namespace slamgw::test
