// SPDX-License-Identifier: Apache-2.0
// A real Mosquitto on a free port of loopback, and mosquitto_sub beside it.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "tests/support/child_process.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {

class Mosquitto {
 public:
  /// `extra_configuration`: lines for mosquitto.conf; with `user` set only that user may connect.
  explicit Mosquitto(std::string extra_configuration = {}, const std::string& user = {},
                     const std::string& password = {});

  /// Starts (again) on the same port; returns when it accepts connections on each
  /// of its ports: it opens one after the other.
  void start();
  void kill();
  /// Stops the process by SIGSTOP; its connections stay open.
  void pause();
  /// Makes it read its access control list again.
  void reload();
  void resume();
  std::uint16_t port() const { return port_; }
  std::string uri() const;

 private:
  TempDir directory_;
  std::uint16_t port_;
  std::vector<std::uint16_t> listeners_;
  std::unique_ptr<ChildProcess> process_;
};

/// `mosquitto_sub` for one filter; one line a message.
class Subscriber {
 public:
  /// `format`: mosquitto_sub's -F; the default is topic and payload in hex. It subscribes at QoS 1,
  /// unless `more` options say otherwise.
  Subscriber(const Mosquitto& broker, const std::string& filter,
             const std::string& format = "%t %x", const std::string& version = "mqttv311",
             const std::vector<std::string>& more = {});
  std::vector<std::string> lines() const;

 private:
  TempDir directory_;
  std::unique_ptr<ChildProcess> process_;
};

void mosquitto_publish(const Mosquitto& broker, const std::vector<std::string>& arguments);

}  // namespace slamgw::test
