// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board_port.hpp"

#include <fmt/core.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <utility>

namespace slamgw::sim::ble {

using boost::asio::posix::stream_descriptor;
using boost::system::error_code;

BoardPort::BoardPort(boost::asio::io_context& io, std::string tty, Network& network,
                     std::size_t board, std::function<void()> pump)
    : tty_(std::move(tty)),
      network_(network),
      board_(board),
      pump_(std::move(pump)),
      terminal_(tty_),
      master_(io, dup(terminal_->master())),
      plug_(io) {}

void BoardPort::restart_board() {
  if (!terminal_) return;
  const unsigned turn = restarts_++ % 3;
  fmt::print(stderr, "the board restarts{}\n", turn == 0 ? ", and its start event is lost" : "");
  const bool is_torn = turn == 1 && to_host_.empty();
  if (is_torn && ::write(terminal_->master(), last_packet_.data(), last_packet_.size() / 2) < 0) {
    fmt::print(stderr, "the host reads nothing\n");
  }
  to_host_.clear();
  network_.reboot_board(std::chrono::steady_clock::now(), Board::reboot_time, board_,
                        turn == 0 ? StartEvent::lost : StartEvent::said);
  pump_();
}

void BoardPort::power_cycle_board() {
  if (!terminal_) return;
  fmt::print(stderr, "the board is unplugged for {} s\n", unplugged_time.count());
  master_.close();
  terminal_.reset();
  to_host_.clear();
  is_waiting_writable_ = false;
  network_.reboot_board(std::chrono::steady_clock::now(), unplugged_time + Board::reboot_time,
                        board_);
  plug_.expires_after(unplugged_time);
  plug_.async_wait([this](error_code error) {
    if (!error) plug_in_board();
  });
  pump_();
}

void BoardPort::plug_in_board() {
  terminal_.emplace(tty_);
  master_.assign(dup(terminal_->master()));
  fmt::print(stderr, "the board is back at {} ({})\n", tty_, terminal_->slave_name());
  read_from_host();
}

void BoardPort::flush_to_host() {
  while (terminal_ && !is_waiting_writable_) {
    if (to_host_.empty()) {
      std::optional<Bytes> packet =
          network_.next_host_packet(std::chrono::steady_clock::now(), board_);
      if (!packet) return;
      to_host_ = std::move(*packet);
      last_packet_ = to_host_;
    }
    const ssize_t written = ::write(terminal_->master(), to_host_.data(), to_host_.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return wait_writable();
    to_host_.erase(to_host_.begin(), to_host_.begin() + written);
  }
}

void BoardPort::wait_writable() {
  is_waiting_writable_ = true;
  master_.async_wait(stream_descriptor::wait_write, [this](error_code error) {
    if (error) return;
    is_waiting_writable_ = false;
    flush_to_host();
  });
}

void BoardPort::read_from_host() {
  master_.async_wait(stream_descriptor::wait_read, [this](error_code error) {
    if (error) return;
    std::array<std::uint8_t, 4096> buffer;
    const ssize_t octets = ::read(terminal_->master(), buffer.data(), buffer.size());
    // Octet by octet, as on a wire: the board answers the first packets before it receives the
    // last.
    for (ssize_t i = 0; i < octets; ++i) {
      network_.on_host_bytes(ByteView(buffer).subspan(static_cast<std::size_t>(i), 1),
                             std::chrono::steady_clock::now(), board_);
      flush_to_host();
    }
    pump_();
    read_from_host();
  });
}

void BoardPort::allow_next_host() {
  if (terminal_) terminal_->allow_next_host();
}

bool BoardPort::is_quiet() const {
  return !terminal_ || (terminal_->unread_octets() == 0 && to_host_.empty());
}

}  // namespace slamgw::sim::ble
