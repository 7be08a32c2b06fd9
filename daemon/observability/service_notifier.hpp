// SPDX-License-Identifier: Apache-2.0
// Notifies systemd of the service's state: ready, reloading, stopping, one line of status, and
// signs of life for its watchdog. Does nothing where systemd did not start the daemon. Used by App
// on the loop's thread: when the loop hangs, no sign of life follows, and systemd restarts the
// service.
#pragma once

#include <boost/asio/io_context.hpp>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "daemon/core/mesh.hpp"
#include "daemon/runtime/timer.hpp"

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

  /// Call when the start is over, and after each reload.
  void ready();
  /// Call before a reload; ready() follows.
  void reloading();
  /// Sends the last notification: no status and no sign of life follows (TimeoutStopSec= applies).
  void stopping();

 private:
  void report_status();

  Timer watchdog_timer_;
  Timer status_timer_;
  std::function<ServiceState()> state_;
  /// Half of the time that systemd allows between two signs of life; nothing without a watchdog.
  std::optional<std::chrono::microseconds> watchdog_interval_;
  std::optional<std::uint64_t> messages_before_;
  std::string last_status_;
  bool is_running_ = false;
};

}  // namespace slamgw
