// SPDX-License-Identifier: Apache-2.0
// A real NATS server with MQTT (3.1.1) over JetStream, on free ports of loopback.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "tests/support/child_process.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {

class NatsServer {
 public:
  static bool is_installed();

  /// Returns when it accepts MQTT connections. `extra_configuration`: users and their permissions.
  explicit NatsServer(const std::string& extra_configuration = {});
  std::uint16_t mqtt_port() const { return mqtt_port_; }
  /// Returns its log, which has its refusals.
  std::string log() const { return read_file(directory_ / "log"); }

 private:
  TempDir directory_;
  std::uint16_t mqtt_port_;
  std::unique_ptr<ChildProcess> process_;
};

}  // namespace slamgw::test
