// SPDX-License-Identifier: Apache-2.0
// One port from opening to closing, on a thread of its own. What it reads is collected and posted
// to the loop, one post at a time. Made by SerialLine for each attempt; the thread keeps this
// object alive, so a port that is stuck in the kernel delays nothing else.
#pragma once

#include <boost/asio/io_context.hpp>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/io/serial_port.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

class SerialLine;

/// What happened since the last report.
struct SerialReport {
  bool is_open = false;
  Bytes bytes;
  std::optional<std::string> failure;  ///< not opened, or lost; the port closes
  bool has_ended = false;              ///< the port is closed, the thread ends
};

class SerialConnection : public std::enable_shared_from_this<SerialConnection> {
 public:
  /// Reports go to `line` on the loop's thread, until `abandon`.
  static std::shared_ptr<SerialConnection> start(boost::asio::io_context& io, OpenPort open_port,
                                                 SerialLine& line);
  ~SerialConnection();
  SerialConnection(const SerialConnection&) = delete;
  SerialConnection& operator=(const SerialConnection&) = delete;

  /// Queues `bytes`. False when more wait than SerialLine::max_unwritten.
  bool write(ByteView bytes);
  void close();
  /// No more reports, neither now nor later. Waits at most `limit` for the port to be closed.
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
  const int wake_;  ///< eventfd: there is something to write, or to close
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

}  // namespace slamgw::ble
