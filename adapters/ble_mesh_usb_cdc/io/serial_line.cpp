// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/post.hpp>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/serial_port.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

namespace asio = boost::asio;

/// One port from opening to closing. A thread of its own makes all calls on the port, as handlers
/// of `io_`. Made by SerialLine for each attempt; the thread keeps this object alive, so a port
/// that is stuck in the kernel delays nothing else.
class SerialConnection : public std::enable_shared_from_this<SerialConnection> {
 public:
  /// Reports go to `line` on the loop's thread, until `abandon`.
  SerialConnection(asio::io_context& loop, OpenPort open_port, SerialLine& line)
      : open_port_(std::move(open_port)), loop_(loop), line_(&line) {}
  void start();

  /// Queues `bytes`. Returns false if more than SerialLine::max_unwritten would wait.
  bool write(ByteView bytes);
  void close();
  /// Ends all reports, queued ones too. Waits at most `limit` for the port to be closed.
  void abandon(Duration limit);

 private:
  // On the thread:
  void open();
  void prepare();
  void read_next();
  void on_read(const boost::system::error_code& error, std::size_t count);
  void write_some();
  void end(const std::string& failure = {});
  void report(std::function<void(SerialLine&)> what);

  const OpenPort open_port_;
  const TimePoint give_up_ = std::chrono::steady_clock::now() + SerialLine::permission_grace;
  std::mutex mutex_;
  asio::io_context& loop_;                 ///< not touched once `line_` is null
  SerialLine* line_;                       ///< null when abandoned
  std::atomic<std::size_t> unwritten_{0};  ///< octets that the port has not taken
  std::atomic<std::size_t> unread_{0};     ///< octets that the loop has not taken
  std::promise<void> ended_;

  asio::io_context io_{1};
  asio::executor_work_guard<asio::io_context::executor_type> work_ = asio::make_work_guard(io_);
  Timer timer_{io_};
  std::unique_ptr<SerialPort> port_;
  asio::posix::stream_descriptor descriptor_{io_};  ///< the port's, while it carries octets
  bool is_reading_ = false;
  bool is_full_ = false;  ///< the kernel takes no octets
  std::array<std::uint8_t, 4096> buffer_{};
  Bytes to_write_;
};

// --- The line, on the loop -----------------------------------------------------------------------

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
  try {
    connection_ = std::make_shared<SerialConnection>(io_, open_port_, *this);
    connection_->start();
  } catch (const std::runtime_error&) {
    connection_.reset();
    state_ = State::closed;
    return callbacks_.on_failed("the serial board can't be opened: too many open files or threads");
  }
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

// Reports of the connection. Each callback may close the line.

void SerialLine::on_open() {
  if (state_ != State::opening) return;
  state_ = State::open;
  stuck_timer_.cancel();
  callbacks_.on_open();
}

void SerialLine::on_bytes(ByteView bytes) {
  if (state_ == State::open) callbacks_.on_bytes(bytes);
}

void SerialLine::on_lost(const std::string& why) {
  if (state_ == State::opening || state_ == State::open) fail(why);
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
  stuck_timer_.after(stuck_after, [this] { on_stuck(); });
}

void SerialLine::on_stuck() {
  if (state_ == State::opening)
    callbacks_.on_open_stuck(
        "the kernel does not open the serial board's port, because the board does not answer on "
        "USB: unplug it and plug it in again");
  if (state_ == State::closing)
    callbacks_.on_close_stuck(
        "the serial board takes no data, and the kernel waits up to 30 s before it closes the "
        "port: unplug the board and plug it in again if this persists");
}

// --- The connection, from the loop ---------------------------------------------------------------

void SerialConnection::start() {
  asio::post(io_, [this] { open(); });
  std::thread([self = shared_from_this()] {
    self->io_.run();
    self->ended_.set_value();
  }).detach();
}

bool SerialConnection::write(ByteView bytes) {
  if (unwritten_ + bytes.size() > SerialLine::max_unwritten) return false;
  unwritten_ += bytes.size();
  asio::post(io_, [this, bytes = Bytes(bytes.begin(), bytes.end())] {
    to_write_.insert(to_write_.end(), bytes.begin(), bytes.end());
    write_some();
  });
  return true;
}

void SerialConnection::close() {
  asio::post(io_, [this] { end(); });
}

void SerialConnection::abandon(Duration limit) {
  close();
  {
    const std::lock_guard lock(mutex_);
    line_ = nullptr;
  }
  ended_.get_future().wait_for(limit);
}

// --- The connection, on the thread ---------------------------------------------------------------

void SerialConnection::open() {
  auto opened = open_port_();
  if (!opened.has_value()) {
    const OpenRefusal& refusal = opened.error();
    if (!refusal.is_denied || std::chrono::steady_clock::now() >= give_up_) return end(refusal.why);
    return timer_.after(SerialLine::permission_retry, [this] { open(); });
  }
  port_ = std::move(*opened);
  port_->set_dtr(false);
  timer_.after(SerialLine::dtr_off_time, [this] { prepare(); });
}

void SerialConnection::prepare() {
  port_->flush_input();
  port_->set_dtr(true);
  boost::system::error_code error;
  descriptor_.assign(port_->descriptor(), error);
  if (!error) descriptor_.non_blocking(true, error);
  if (error) return end("the serial board can't be read: " + error.message());
  report([](SerialLine& line) { line.on_open(); });
  read_next();
}

/// Reads until the loop has `max_unread` octets to take; the kernel keeps the rest meanwhile.
void SerialConnection::read_next() {
  if (!descriptor_.is_open() || is_reading_ || unread_ >= SerialLine::max_unread) return;
  is_reading_ = true;
  descriptor_.async_read_some(
      asio::buffer(buffer_),
      [this](const boost::system::error_code& error, std::size_t count) { on_read(error, count); });
}

void SerialConnection::on_read(const boost::system::error_code& error, std::size_t count) {
  is_reading_ = false;
  if (!descriptor_.is_open()) return;
  if (error)
    return end("the serial board is gone (" +
               (error == asio::error::eof ? "end of file" : error.message()) + ")");
  unread_ += count;
  report([this, bytes = Bytes(buffer_.begin(), buffer_.begin() + count)](SerialLine& line) {
    unread_ -= bytes.size();
    asio::post(io_, [this] { read_next(); });
    line.on_bytes(bytes);
  });
  read_next();
}

/// Writes as much as the kernel takes now.
void SerialConnection::write_some() {
  while (descriptor_.is_open() && !is_full_ && !to_write_.empty()) {
    boost::system::error_code error;
    const std::size_t count =
        descriptor_.write_some(asio::buffer(to_write_, port_->max_write_bytes()), error);
    if (error == asio::error::would_block || error == asio::error::interrupted) {
      is_full_ = true;
      return descriptor_.async_wait(descriptor_.wait_write,
                                    [this](const boost::system::error_code&) {
                                      is_full_ = false;
                                      // The read goes first: it says that the board is gone.
                                      asio::post(io_, [this] { write_some(); });
                                    });
    }
    if (error) return end("writing to the serial board failed: " + error.message());
    to_write_.erase(to_write_.begin(), to_write_.begin() + static_cast<std::ptrdiff_t>(count));
    unwritten_ -= count;
  }
}

/// Closes the port, which ends the thread.
void SerialConnection::end(const std::string& failure) {
  if (!work_.owns_work()) return;
  if (!failure.empty()) report([failure](SerialLine& line) { line.on_lost(failure); });
  timer_.cancel();
  if (descriptor_.is_open()) descriptor_.release();
  if (port_) port_->set_dtr(false);
  port_.reset();
  report([](SerialLine& line) { line.on_thread_ended(); });
  work_.reset();
}

/// Calls `what` on the loop's thread, the only one that makes `line_` null.
void SerialConnection::report(std::function<void(SerialLine&)> what) {
  const std::lock_guard lock(mutex_);
  if (line_ == nullptr) return;
  asio::post(loop_, [self = shared_from_this(), what = std::move(what)] {
    if (self->line_ != nullptr) what(*self->line_);
  });
}

}  // namespace slamgw::ble
