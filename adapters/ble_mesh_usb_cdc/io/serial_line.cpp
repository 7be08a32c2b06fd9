// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"

#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/serial_connection.hpp"

namespace slamgw::ble {

SerialLine::SerialLine(boost::asio::io_context& io, OpenPort open_port, Callbacks callbacks)
    : io_(io),
      open_port_(std::move(open_port)),
      callbacks_(std::move(callbacks)),
      stuck_timer_(io) {}

void SerialLine::open() {
  if (state_ == State::closed) return start();
  if (state_ == State::closing) is_open_wanted_ = true;
}

void SerialLine::start() {
  state_ = State::opening;
  is_open_wanted_ = false;
  connection_ = SerialConnection::start(io_, open_port_, *this);
  watch();
}

void SerialLine::close() {
  is_open_wanted_ = false;
  if (state_ == State::closed || state_ == State::closing) return;
  state_ = State::closing;
  connection_->close();
  watch();
}

void SerialLine::write(ByteView bytes) {
  if (state_ != State::open) return;
  if (!connection_->write(bytes))
    fail("the serial board takes no data: check ble_mesh.flow_control");
}

void SerialLine::stop() {
  close();
  stuck_timer_.cancel();
  if (auto connection = std::exchange(connection_, nullptr)) connection->abandon(stop_limit);
  state_ = State::closed;
}

void SerialLine::on_report(SerialReport report) {
  if (report.is_open && state_ == State::opening) {
    state_ = State::open;
    stuck_timer_.cancel();
    callbacks_.on_open();
  }
  // Each callback may close the line.
  if (!report.bytes.empty() && state_ == State::open) callbacks_.on_bytes(report.bytes);
  const bool is_lost = state_ == State::opening || state_ == State::open;
  if (report.failure && is_lost) fail(*report.failure);
  if (report.has_ended && connection_) on_thread_ended();
}

void SerialLine::fail(const std::string& why) {
  close();
  callbacks_.on_failed(why);
}

void SerialLine::on_thread_ended() {
  stuck_timer_.cancel();
  connection_.reset();
  state_ = State::closed;
  if (is_open_wanted_) start();
}

void SerialLine::watch() {
  stuck_timer_.expires_after(stuck_after);
  stuck_timer_.async_wait([this, alive = std::weak_ptr(alive_)](boost::system::error_code error) {
    if (error || alive.expired()) return;
    if (stuck_timer_.expiry() <= std::chrono::steady_clock::now()) on_stuck();
  });
}

void SerialLine::on_stuck() {
  if (state_ == State::opening)
    callbacks_.on_open_stuck(
        "the kernel does not open the serial board's port, because the board does not answer on "
        "USB: unplug it and plug it in again");
  if (state_ == State::closing)
    callbacks_.on_close_stuck(
        "the serial board takes no data, and the kernel waits up to 30 s before it closes the "
        "port: unplug the board and plug it in again if it stays so");
}

}  // namespace slamgw::ble
