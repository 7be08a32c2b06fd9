// SPDX-License-Identifier: Apache-2.0
// The serial port of one board: a pty, octets in flight to the host, and the faults that signals
// request. SerialSide has one for each board.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <optional>
#include <string>

#include "simulation/ble/network.hpp"
#include "simulation/ble/pseudo_terminal.hpp"

namespace slamgw::sim::ble {

class BoardPort {
 public:
  static constexpr std::chrono::seconds unplugged_time{2};

  /// `network` must outlive this object; `pump` runs it after each input. Throws std::system_error.
  BoardPort(boost::asio::io_context& io, std::string tty, Network& network, std::size_t board,
            std::function<void()> pump);

  const std::string& tty() const { return tty_; }
  const std::string& slave_name() const { return terminal_->slave_name(); }
  void read_from_host();
  /// Moves packets from the board's transmit buffer to the pty. A host that does not read makes the
  /// buffer overflow, as on the real board.
  void flush_to_host();
  void allow_next_host();
  /// Restarts the board behind the open port. In turn its start event is lost, follows an event
  /// that the restart has cut, so that it looks like the rest of that one, and arrives undamaged.
  void restart_board();
  /// Removes port and power for `unplugged_time`.
  void power_cycle_board();
  /// Returns true if the host has read all octets.
  bool is_quiet() const;

 private:
  void wait_writable();
  void plug_in_board();

  const std::string tty_;
  Network& network_;
  const std::size_t board_;
  std::function<void()> pump_;
  std::optional<PseudoTerminal> terminal_;  ///< nothing while the board is unplugged
  boost::asio::posix::stream_descriptor master_;
  boost::asio::steady_timer plug_;
  Bytes to_host_;      ///< the rest of the packet that is being written
  Bytes last_packet_;  ///< the packet before it
  unsigned restarts_ = 0;
  bool is_waiting_writable_ = false;
};

}  // namespace slamgw::sim::ble
