// SPDX-License-Identifier: Apache-2.0
// Reads and writes one serial port for the loop. A thread of its own makes every call on the tty,
// because each call may wait in the kernel (serial_port.hpp). Called by SerialShell on the loop's
// thread, where all callbacks fire as well.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <memory>
#include <string>

#include "adapters/ble_mesh_usb_cdc/io/serial_port.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw::ble {

class SerialConnection;

class SerialLine {
 public:
  /// Octets waiting for a port that does not take them (no flow control, board hung). The board
  /// link has one command in flight, so more than this means that the port is stuck.
  static constexpr std::size_t max_unwritten = 16384;
  /// Octets read that the loop has not taken yet; the rest waits in the kernel. Six seconds at
  /// 115200 baud.
  static constexpr std::size_t max_unread = 65536;
  /// Nordic's USB firmware delivers an earlier reader's octets unless DTR was off for this long.
  static constexpr Duration dtr_off_time = std::chrono::milliseconds{100};
  /// udev gives a new node its group some milliseconds after the node is there.
  static constexpr Duration permission_grace = std::chrono::seconds{2};
  static constexpr Duration permission_retry = std::chrono::milliseconds{100};
  /// Opening or closing that takes longer is reported.
  static constexpr Duration stuck_after = std::chrono::seconds{5};
  /// `stop` waits at most this long for the port to close, so that the next program finds it free.
  static constexpr Duration stop_limit = std::chrono::milliseconds{250};

  struct Callbacks {
    std::function<void()> on_open;
    std::function<void(ByteView)> on_bytes;
    /// The port could not be opened, was lost, or does not take written octets. It is closed.
    std::function<void(const std::string& why)> on_failed;
    /// The kernel keeps open() or close() waiting; nothing is opened until that ends.
    std::function<void(const std::string& why)> on_open_stuck;
    std::function<void(const std::string& why)> on_close_stuck;
  };

  SerialLine(boost::asio::io_context& io, OpenPort open_port, Callbacks callbacks);
  ~SerialLine() { stop(); }

  /// Opens the port now, or as soon as an earlier one is closed. Ends in on_open or on_failed.
  void open();
  /// Returns at once; no callback but on_close_stuck follows. Written octets that fit into the
  /// kernel's buffer are still handed over.
  void close();
  /// Does nothing while the port is not open.
  void write(ByteView bytes);
  /// As close(), but final; waits at most `stop_limit`. A port that takes longer to close is left
  /// to the end of the process.
  void stop();

 private:
  friend class SerialConnection;
  enum class State : std::uint8_t { closed, opening, open, closing };

  void start();
  void on_open();
  void on_bytes(ByteView bytes);
  void on_lost(const std::string& why);
  void fail(const std::string& why);
  void on_thread_ended();
  void watch();
  void on_stuck();

  boost::asio::io_context& io_;
  OpenPort open_port_;
  Callbacks callbacks_;
  Timer stuck_timer_;
  State state_ = State::closed;
  bool is_open_wanted_ = false;                   ///< while closing
  std::shared_ptr<SerialConnection> connection_;  ///< null while closed
};

}  // namespace slamgw::ble
