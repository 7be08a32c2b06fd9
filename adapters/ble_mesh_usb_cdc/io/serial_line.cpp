// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/serial_port.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"
#include "daemon/runtime/owned_file.hpp"

namespace slamgw::ble {

/// Octets and changes of state since the last report.
struct SerialReport {
  bool is_open = false;
  Bytes bytes;
  std::optional<std::string> failure;  ///< not opened, or lost; the port closes
  bool has_ended = false;              ///< the port is closed, the thread ends
};

/// One port from opening to closing, on a thread of its own. Collects the octets that it reads and
/// posts them to the loop, one post at a time. Made by SerialLine for each attempt; the thread
/// keeps this object alive, so a port that is stuck in the kernel delays nothing else.
class SerialConnection : public std::enable_shared_from_this<SerialConnection> {
 public:
  /// Reports go to `line` on the loop's thread, until `abandon`.
  static std::shared_ptr<SerialConnection> start(boost::asio::io_context& io, OpenPort open_port,
                                                 SerialLine& line);
  SerialConnection(const SerialConnection&) = delete;
  SerialConnection& operator=(const SerialConnection&) = delete;

  /// Queues `bytes`. Returns false if more than SerialLine::max_unwritten would wait.
  bool write(ByteView bytes);
  void close();
  /// Ends all reports, queued ones too. Waits at most `limit` for the port to be closed.
  void abandon(Duration limit);

 private:
  SerialConnection(boost::asio::io_context& io, OpenPort open_port, SerialLine& line);

  // On the thread:
  void run();
  std::unique_ptr<SerialPort> open();
  bool prepare(SerialPort& port);
  void carry(SerialPort& port);
  bool read_some(SerialPort& port);
  bool write_some(SerialPort& port);
  bool is_closing();
  void rest(Duration time);
  void fail(std::string why);
  template <class Change>
  void report(Change change);

  // On the loop:
  void deliver();

  const OpenPort open_port_;
  const OwnedFile wake_;  ///< eventfd: there is something to write, or to close
  std::mutex mutex_;
  std::condition_variable ended_;
  boost::asio::io_context& io_;  ///< not touched once `line_` is null
  SerialLine* line_;             ///< null when abandoned
  SerialReport report_;
  bool is_posted_ = false;
  bool is_closing_ = false;
  bool has_ended_ = false;
  Bytes unwritten_;
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

namespace {

bool would_block(int error) { return error == EAGAIN || error == EWOULDBLOCK || error == EINTR; }

}  // namespace

std::shared_ptr<SerialConnection> SerialConnection::start(boost::asio::io_context& io,
                                                          OpenPort open_port, SerialLine& line) {
  std::shared_ptr<SerialConnection> connection(
      new SerialConnection(io, std::move(open_port), line));
  std::thread([connection] { connection->run(); }).detach();
  return connection;
}

SerialConnection::SerialConnection(boost::asio::io_context& io, OpenPort open_port,
                                   SerialLine& line)
    : open_port_(std::move(open_port)),
      wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)),
      io_(io),
      line_(&line) {}

// --- From the loop -------------------------------------------------------------------------------

bool SerialConnection::write(ByteView bytes) {
  {
    const std::lock_guard lock(mutex_);
    if (unwritten_.size() + bytes.size() > SerialLine::max_unwritten) return false;
    unwritten_.insert(unwritten_.end(), bytes.begin(), bytes.end());
  }
  ::eventfd_write(wake_.get(), 1);
  return true;
}

void SerialConnection::close() {
  {
    const std::lock_guard lock(mutex_);
    is_closing_ = true;
  }
  ::eventfd_write(wake_.get(), 1);
}

void SerialConnection::abandon(Duration limit) {
  close();
  std::unique_lock lock(mutex_);
  line_ = nullptr;
  ended_.wait_for(lock, limit, [this] { return has_ended_; });
}

void SerialConnection::deliver() {
  SerialReport report;
  SerialLine* line = nullptr;
  {
    const std::lock_guard lock(mutex_);
    is_posted_ = false;
    report = std::exchange(report_, {});
    line = line_;  // only the loop's thread, this one, makes it null
  }
  ::eventfd_write(wake_.get(), 1);  // there is room to read again
  if (line != nullptr) line->on_report(std::move(report));
}

// --- On the thread -------------------------------------------------------------------------------

void SerialConnection::run() {
  if (auto port = open()) {
    if (prepare(*port)) carry(*port);
    port->set_dtr(false);
  }
  report([](SerialReport& report) { report.has_ended = true; });
  const std::lock_guard lock(mutex_);
  has_ended_ = true;
  ended_.notify_all();
}

std::unique_ptr<SerialPort> SerialConnection::open() {
  if (wake_.get() < 0) {
    fail("the serial board can't be opened: too many open files");
    return nullptr;
  }
  const TimePoint give_up = std::chrono::steady_clock::now() + SerialLine::permission_grace;
  while (!is_closing()) {
    auto opened = open_port_();
    if (opened.has_value()) return std::move(*opened);
    const OpenRefusal& refusal = opened.error();
    if (!refusal.is_denied || std::chrono::steady_clock::now() >= give_up) {
      fail(refusal.why);
      return nullptr;
    }
    rest(SerialLine::permission_retry);
  }
  return nullptr;
}

/// Returns false if the port is to be closed again.
bool SerialConnection::prepare(SerialPort& port) {
  port.set_dtr(false);
  rest(SerialLine::dtr_off_time);
  port.flush_input();
  port.set_dtr(true);
  if (is_closing()) return false;
  report([](SerialReport& report) { report.is_open = true; });
  return true;
}

void SerialConnection::carry(SerialPort& port) {
  bool is_usable = true;
  while (is_usable && !is_closing()) {
    std::array<pollfd, 2> watched{{{wake_.get(), POLLIN, 0}, {port.descriptor(), 0, 0}}};
    {
      const std::lock_guard lock(mutex_);
      const bool has_room = report_.bytes.size() < SerialLine::max_unread;
      watched[1].events =
          static_cast<short>((has_room ? POLLIN : 0) | (unwritten_.empty() ? 0 : POLLOUT));
    }
    if (::poll(watched.data(), watched.size(), -1) < 0 && errno != EINTR) return;
    eventfd_t ignored = 0;
    ::eventfd_read(wake_.get(), &ignored);
    if ((watched[1].revents & ~POLLOUT) != 0) is_usable = read_some(port);
    if (is_usable) is_usable = write_some(port);
  }
  if (is_usable) write_some(port);  // octets that the loop queued before it closed the line
}

bool SerialConnection::read_some(SerialPort& port) {
  std::array<std::uint8_t, 4096> buffer{};
  const ssize_t count = ::read(port.descriptor(), buffer.data(), buffer.size());
  if (count < 0 && would_block(errno)) return true;
  if (count <= 0) {
    const char* const reason = count == 0 ? "end of file" : std::strerror(errno);
    fail(std::string("the serial board is gone (") + reason + ")");
    return false;
  }
  const ByteView bytes = ByteView(buffer).first(static_cast<std::size_t>(count));
  report([bytes](SerialReport& report) {
    report.bytes.insert(report.bytes.end(), bytes.begin(), bytes.end());
  });
  return true;
}

/// Writes as much as the kernel takes now. Returns false if the port is lost.
bool SerialConnection::write_some(SerialPort& port) {
  while (true) {
    Bytes next;
    {
      const std::lock_guard lock(mutex_);
      const std::size_t count = std::min(unwritten_.size(), port.max_write_bytes());
      next.assign(unwritten_.begin(), unwritten_.begin() + static_cast<std::ptrdiff_t>(count));
    }
    if (next.empty()) return true;
    const ssize_t count = ::write(port.descriptor(), next.data(), next.size());
    if (count < 0) {
      if (would_block(errno)) return true;
      fail(std::string("writing to the serial board failed: ") + std::strerror(errno));
      return false;
    }
    const std::lock_guard lock(mutex_);
    unwritten_.erase(unwritten_.begin(), unwritten_.begin() + count);
  }
}

bool SerialConnection::is_closing() {
  const std::lock_guard lock(mutex_);
  return is_closing_;
}

/// Waits for this time, or until there is something to do.
void SerialConnection::rest(Duration time) {
  pollfd watched{wake_.get(), POLLIN, 0};
  const auto limit = std::chrono::duration_cast<std::chrono::milliseconds>(time);
  ::poll(&watched, 1, static_cast<int>(limit.count()));
}

void SerialConnection::fail(std::string why) {
  report([&why](SerialReport& report) { report.failure = std::move(why); });
}

template <class Change>
void SerialConnection::report(Change change) {
  const std::lock_guard lock(mutex_);
  if (line_ == nullptr) return;
  change(report_);
  if (std::exchange(is_posted_, true)) return;
  boost::asio::post(io_, [self = shared_from_this()] { self->deliver(); });
}

}  // namespace slamgw::ble
