// SPDX-License-Identifier: Apache-2.0
// What the shells of both protocols on the serial port have in common: the port, opened again and
// again until it is there, its octets to the machine, and the machine's one timer. A missing board
// is a state, not a failure. Loop's thread only.
#pragma once

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"
#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/runtime/mesh_shell.hpp"

namespace slamgw::ble {

template <MeshProtocolMachine Machine>
class SerialShell : public MeshShell<Machine> {
 public:
  static constexpr Duration first_open_delay = std::chrono::milliseconds{500};
  static constexpr Duration max_open_delay = std::chrono::seconds{5};

  void start() override {
    is_stopped_ = false;
    if (!problem_.empty()) {
      notify(Severity::error, problem_);
      listener_.on_mesh_event(LinkChange{Mesh::ble, false, problem_});
      return;
    }
    driver_->on_start();
    open_after(Duration::zero());
  }
  void stop() override {
    is_stopped_ = true;
    driver_.stop();
    timer_.cancel();
    line_.stop();
  }
  std::vector<WaitingMessage> give_up(const std::string& robot) override {
    return driver_->give_up(robot, read_clocks());
  }
  /// `robots` of the configuration, read again. Robots stay in the mesh.
  void reconfigure(RobotNames names) {
    if (is_stopped_ || !problem_.empty()) return;
    driver_->on_names(std::move(names), read_clocks());
  }

 protected:
  using MachineAction = ActionOf<Machine>;

  struct Made {
    std::unique_ptr<Machine> machine;
    std::string problem;  ///< why the mesh stays off; empty when it does not
  };

  /// `listener` outlives the shell. `open_port` opens the serial port in place of open_serial_port;
  /// it is called on a thread of its own.
  SerialShell(boost::asio::io_context& io, const Settings& settings, Made made,
              MeshListener& listener, OpenPort open_port)
      : problem_(std::move(made.problem)),
        listener_(listener),
        machine_(std::move(made.machine)),
        driver_(io, *machine_,
                [this](MachineAction& action) {
                  if (!is_stopped_) perform(action);
                }),
        line_(io,
              open_port ? std::move(open_port) : [settings] { return open_serial_port(settings); },
              {.on_open = [this] { on_port_open(); },
               .on_bytes = [this](ByteView bytes) { driver_->on_bytes(bytes, read_clocks()); },
               .on_failed = [this](const std::string& why) { on_port_failed(why); },
               .on_open_stuck = [this](const std::string& why) { on_port_closed(why); },
               .on_close_stuck = [this](const std::string& why) { on_close_stuck(why); }}),
        timer_(io) {}

  /// Does one action of the machine; not called after stop().
  virtual void perform(MachineAction& action) = 0;
  void write(const WriteSerial& serial) { line_.write(serial.bytes); }
  void reopen(const ReopenPort& reopen) {
    line_.close();
    open_after(reopen.after);
  }

  bool is_stopped() const { return is_stopped_; }
  const std::string& problem() const { return problem_; }
  MeshListener& listener() { return listener_; }
  void notify(Severity severity, std::string text) {
    listener_.on_mesh_event(Notice{severity, std::move(text), {}});
  }
  const Machine& machine() const { return *machine_; }
  boost::asio::any_io_executor loop() { return timer_.get_executor(); }
  MachineDriver<Machine>& driver() override { return driver_; }
  const MachineDriver<Machine>& driver() const override { return driver_; }

 private:
  void open_after(Duration delay) {
    timer_.expires_after(delay);
    timer_.async_wait([this, life = std::weak_ptr(life_)](boost::system::error_code error) {
      if (!error && !life.expired() && !is_stopped_) line_.open();
    });
  }
  void on_port_open() {
    open_delay_ = first_open_delay;
    driver_->on_port_open(read_clocks());
  }
  void on_port_failed(const std::string& why) {
    open_after(open_delay_);
    open_delay_ = std::min(open_delay_ * 2, max_open_delay);
    on_port_closed(why);
  }
  void on_port_closed(const std::string& why) { driver_->on_port_closed(why, read_clocks()); }
  void on_close_stuck(const std::string& why) {
    if (stuck_throttle_.on_event(std::chrono::steady_clock::now())) notify(Severity::warning, why);
  }

  std::string problem_;
  MeshListener& listener_;
  std::unique_ptr<Machine> machine_;
  MachineDriver<Machine> driver_;
  SerialLine line_;
  boost::asio::steady_timer timer_;  ///< the next attempt to open
  Duration open_delay_ = first_open_delay;
  LogThrottle stuck_throttle_{
      std::chrono::minutes{10}};  ///< a hung board is closed again and again
  bool is_stopped_ = true;
  std::shared_ptr<void> life_ = std::make_shared<char>();  ///< a queued handler can't be cancelled
};

}  // namespace slamgw::ble
