// SPDX-License-Identifier: Apache-2.0
// Tells systemd about the service: ready, reloading, stopping, one line of status, and signs of
// life for its watchdog. Does nothing where systemd did not start the daemon. Used by App on the
// loop's thread; a loop that hangs feeds the watchdog no longer, so that systemd restarts the
// service.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "daemon/core/mesh.hpp"

namespace slamgw {

/// The values of the status line.
struct ServiceState {
  bool broker_is_up = false;
  PerMesh<std::optional<bool>> mesh_is_up;  ///< nothing when not enabled
  std::size_t robots_online = 0;
  std::uint64_t messages = 0;  ///< both directions, since the start
};

/// "broker up, ble down, thread up, 6 robots online, 30 msg/s"
std::string service_status(const ServiceState& state, std::uint64_t messages_per_second);

class ServiceNotifier {
 public:
  /// `state` is called once a second from ready() on.
  ServiceNotifier(boost::asio::io_context& io, std::function<ServiceState()> state);

  /// The start is over, or a reload.
  void ready();
  /// Between SIGHUP and the next ready().
  void reloading();
  /// The last notification: no status and no sign of life follows it (TimeoutStopSec= takes over).
  void stopping();

 private:
  void feed_watchdog();
  void report_status();

  boost::asio::steady_timer watchdog_timer_;
  boost::asio::steady_timer status_timer_;
  std::function<ServiceState()> state_;
  /// Half of what systemd allows between two signs of life; none when it does not watch.
  std::optional<std::chrono::microseconds> watchdog_interval_;
  std::optional<std::uint64_t> messages_before_;
  std::string last_status_;
  bool is_running_ = false;
};

}  // namespace slamgw
