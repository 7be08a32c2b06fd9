// SPDX-License-Identifier: Apache-2.0
// The common part of the shells of both protocols on the serial port. It opens the port, again and
// again until it is there, and passes its octets to the machine. A missing board is a state, not a
// failure. Loop's thread only.
#pragma once

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/ble_shell.hpp"
#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"
#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw::ble {

/// `Shell` is a BleShell.
template <class Shell>
class SerialShell : public Shell {
 public:
  static constexpr Duration first_open_delay = std::chrono::milliseconds{500};
  static constexpr Duration max_open_delay = std::chrono::seconds{5};

 protected:
  /// `open_port` opens the serial port in place of open_serial_port; it is called on a thread of
  /// its own. `for_shell`: further arguments of Shell's constructor, after `io`.
  template <class... ForShell>
  SerialShell(OpenPort open_port, const Settings& settings, boost::asio::io_context& io,
              ForShell&&... for_shell)
      : Shell(io, std::forward<ForShell>(for_shell)...),
        line_(
            io,
            open_port ? std::move(open_port) : [settings] { return open_serial_port(settings); },
            {.on_open = [this] { on_port_open(); },
             .on_bytes = [this](ByteView bytes) { this->driver()->on_bytes(bytes, read_clocks()); },
             .on_failed = [this](const std::string& why) { on_port_failed(why); },
             .on_open_stuck = [this](const std::string& why) { on_port_closed(why); },
             .on_close_stuck = [this](const std::string& why) { on_close_stuck(why); }}),
        timer_(io) {}

  /// Performs the machine's actions for its port.
  void perform_on_port(const WriteSerial& serial) { line_.write(serial.bytes); }
  void perform_on_port(const ReopenPort& reopen) {
    line_.close();
    open_after(reopen.after);
  }

 private:
  void open() override { open_after(Duration::zero()); }
  void close() override {
    timer_.cancel();
    line_.stop();
  }
  void open_after(Duration delay) {
    timer_.after(delay, [this] {
      if (!this->is_stopped()) line_.open();
    });
  }
  void on_port_open() {
    open_delay_ = first_open_delay;
    this->driver()->on_port_open(read_clocks());
  }
  void on_port_failed(const std::string& why) {
    open_after(open_delay_);
    open_delay_ = std::min(open_delay_ * 2, max_open_delay);
    on_port_closed(why);
  }
  void on_port_closed(const std::string& why) {
    this->driver()->on_port_closed(why, read_clocks());
  }
  void on_close_stuck(const std::string& why) {
    if (stuck_throttle_.on_event(std::chrono::steady_clock::now()))
      this->notify(Severity::warning, why);
  }

  SerialLine line_;
  Timer timer_;  ///< the next attempt to open
  Duration open_delay_ = first_open_delay;
  LogThrottle stuck_throttle_{
      std::chrono::minutes{10}};  ///< a hung board is closed again and again
};

}  // namespace slamgw::ble
