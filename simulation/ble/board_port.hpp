// SPDX-License-Identifier: Apache-2.0
// The serial port of one board: a pty, what is on its way to the host, and the trouble that signals
// ask for. SerialSide has one for each board.
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

  /// `network` outlives it; `pump` lets it run after each input. Throws std::system_error.
  BoardPort(boost::asio::io_context& io, std::string tty, Network& network, std::size_t board,
            std::function<void()> pump);

  const std::string& tty() const { return tty_; }
  const std::string& slave_name() const { return terminal_->slave_name(); }
  void read_from_host();
  /// Packets leave the board's transmit buffer only when the pty takes them: a host that does not
  /// read makes it overflow, as on the real one.
  void flush_to_host();
  void allow_next_host();
  /// The port stays open. In turn the board's start event is lost, comes after an event that the
  /// restart has cut, so that the host takes it for the rest of that one, and comes whole.
  void restart_board();
  /// Unplugged for `unplugged_time`: the port and the power are gone.
  void power_cycle_board();
  /// The host has read everything.
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
  Bytes to_host_;      ///< what is left of the packet that is being written
  Bytes last_packet_;  ///< the one before
  unsigned restarts_ = 0;
  bool is_waiting_writable_ = false;
};

}  // namespace slamgw::sim::ble
