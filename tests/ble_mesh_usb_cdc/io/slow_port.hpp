// SPDX-License-Identifier: Apache-2.0
// A serial port whose calls wait until the test lets them return, as a kernel's do while a board
// does not read from USB.
#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/serial_port.hpp"

namespace slamgw::ble {

/// Waits while the gate is shut. Call from any thread.
class Gate {
 public:
  void shut() { set(true); }
  void open() { set(false); }
  /// Returns true while a call is waiting.
  bool has_waiting_call() const {
    const std::lock_guard lock(mutex_);
    return waiting_ > 0;
  }
  /// Returns after a limit that only a failing test reaches.
  void pass() {
    std::unique_lock lock(mutex_);
    ++waiting_;
    opened_.wait_for(lock, std::chrono::seconds{30}, [this] { return !is_shut_; });
    --waiting_;
  }

 private:
  void set(bool is_shut) {
    const std::lock_guard lock(mutex_);
    is_shut_ = is_shut;
    opened_.notify_all();
  }

  mutable std::mutex mutex_;
  std::condition_variable opened_;
  bool is_shut_ = false;
  int waiting_ = 0;
};

struct Gates {
  Gate opening;
  Gate setting_dtr;
  Gate closing;
};

class SlowPort final : public SerialPort {
 public:
  SlowPort(std::unique_ptr<SerialPort> port, std::shared_ptr<Gates> gates)
      : port_(std::move(port)), gates_(std::move(gates)) {}
  ~SlowPort() override { gates_->closing.pass(); }

  int descriptor() const override { return port_->descriptor(); }
  std::size_t max_write_bytes() const override { return port_->max_write_bytes(); }
  void set_dtr(bool is_on) override {
    gates_->setting_dtr.pass();
    port_->set_dtr(is_on);
  }
  void flush_input() override { port_->flush_input(); }

 private:
  std::unique_ptr<SerialPort> port_;
  std::shared_ptr<Gates> gates_;
};

inline OpenPort open_slowly(Settings settings, std::shared_ptr<Gates> gates) {
  return [settings, gates]() -> Result<std::unique_ptr<SerialPort>, OpenRefusal> {
    gates->opening.pass();
    auto port = open_serial_port(settings);
    if (!port.has_value()) return port.error();
    return std::unique_ptr<SerialPort>(std::make_unique<SlowPort>(std::move(*port), gates));
  };
}

}  // namespace slamgw::ble
