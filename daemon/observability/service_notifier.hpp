// SPDX-License-Identifier: Apache-2.0
// What systemd is told of the service: ready, reloading, stopping, one line of status, and signs of
// life for its watchdog. Does nothing where systemd did not start the daemon. Used by App on the
// loop's thread; a loop that no longer turns no longer feeds the watchdog, which is the point.
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

/// What the status line is made of.
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
  /// `state` is asked for once a second from ready() on.
  ServiceNotifier(boost::asio::io_context& io, std::function<ServiceState()> state);

  /// The start is over, or a reload.
  void ready();
  /// Between SIGHUP and the next ready().
  void reloading();
  /// The last word: no status and no sign of life comes after it (TimeoutStopSec= takes over).
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
  std::string told_;
  bool is_running_ = false;
};

}  // namespace slamgw
