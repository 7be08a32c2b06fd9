// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/serial_connection.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/post.hpp>
#include <cerrno>
#include <cstring>
#include <thread>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/io/serial_line.hpp"

namespace slamgw::ble {
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

SerialConnection::~SerialConnection() {
  if (wake_ >= 0) ::close(wake_);
}

// --- From the loop -------------------------------------------------------------------------------

bool SerialConnection::write(ByteView bytes) {
  {
    const std::lock_guard lock(mutex_);
    if (unwritten_.size() + bytes.size() > SerialLine::max_unwritten) return false;
    unwritten_.insert(unwritten_.end(), bytes.begin(), bytes.end());
  }
  ::eventfd_write(wake_, 1);
  return true;
}

void SerialConnection::close() {
  {
    const std::lock_guard lock(mutex_);
    is_closing_ = true;
  }
  ::eventfd_write(wake_, 1);
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
  ::eventfd_write(wake_, 1);  // there is room to read again
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
  if (wake_ < 0) {
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

/// False when the port is to be closed again.
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
    std::array<pollfd, 2> watched{{{wake_, POLLIN, 0}, {port.descriptor(), 0, 0}}};
    {
      const std::lock_guard lock(mutex_);
      const bool has_room = report_.bytes.size() < SerialLine::max_unread;
      watched[1].events =
          static_cast<short>((has_room ? POLLIN : 0) | (unwritten_.empty() ? 0 : POLLOUT));
    }
    if (::poll(watched.data(), watched.size(), -1) < 0 && errno != EINTR) return;
    eventfd_t ignored = 0;
    ::eventfd_read(wake_, &ignored);
    if ((watched[1].revents & ~POLLOUT) != 0) is_usable = read_some(port);
    if (is_usable) is_usable = write_some(port);
  }
  if (is_usable) write_some(port);  // what the loop wrote before it closed the line
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

/// As much as the kernel takes now. False when the port is lost.
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

/// Ends early when there is something to do.
void SerialConnection::rest(Duration time) {
  pollfd watched{wake_, POLLIN, 0};
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
