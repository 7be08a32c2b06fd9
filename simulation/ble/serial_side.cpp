// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/serial_side.hpp"

#include <fmt/core.h>

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <boost/asio/steady_timer.hpp>
#include <csignal>
#include <deque>
#include <stdexcept>

#include "simulation/ble/board_port.hpp"
#include "simulation/ble/network.hpp"
#include "simulation/ble/state_file.hpp"
#include "simulation/update_record.hpp"

namespace slamgw::sim::ble {
namespace {

namespace asio = boost::asio;
using boost::system::error_code;

constexpr int no_terminal = 1;
constexpr int robot_is_gone = 3;
constexpr std::chrono::seconds progress_interval{10};
constexpr std::chrono::seconds periodic_interval{1};
constexpr std::chrono::milliseconds drain_step{100};
constexpr int drain_steps = 50;  // the host gets 5 s to read what is left

class SerialSide {
 public:
  explicit SerialSide(const BleOptions& options);
  int run();

 private:
  void pump();
  void write_record();
  void report_failed_assertions();
  void flush_to_hosts();
  void wait_signal();
  void on_signal(int signal);
  void do_periodic_work();
  void save_state();
  void report_progress();
  void finish_when_done();
  void drain(int steps_left, int quiet_steps);

  const BleOptions& options_;
  asio::io_context io_;
  asio::signal_set signals_{io_, SIGINT, SIGTERM, SIGUSR1};
  asio::steady_timer next_event_{io_};
  asio::steady_timer periodic_{io_};
  asio::steady_timer progress_{io_};
  asio::steady_timer end_{io_};
  Network network_;
  std::deque<BoardPort> ports_;
  UpdateRecord record_;
  std::string saved_state_;
  std::size_t power_cycled_ = 0;  ///< number of power cycles; boards take turns
  std::size_t restarted_ = 0;
  bool is_ending_ = false;
};

SerialSide::SerialSide(const BleOptions& options)
    : options_(options),
      network_(options),
      record_(options.common.record, options.common.trace, "ble") {
  signals_.add(SIGUSR2);
  for (std::size_t board = 0; board < options.ttys.size(); ++board)
    ports_.emplace_back(io_, options.ttys[board], network_, board, [this] { pump(); });
  if (options.state.empty()) return;
  saved_state_ = read_state(options.state);
  try {
    if (!saved_state_.empty()) restore_state(network_, saved_state_);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(options.state + ": " + error.what());
  }
}

int SerialSide::run() {
  for (const BoardPort& port : ports_)
    fmt::print(stderr, "serial board at {} ({}), {} robots behind it\n", port.tty(),
               port.slave_name(), options_.common.robots);
  if (options_.common.robots > ReplayList::capacity) {
    fmt::print(stderr, "the board's replay list has {} places: it hears no more robots than that\n",
               ReplayList::capacity);
  }
  wait_signal();
  network_.on_start(std::chrono::steady_clock::now());
  for (BoardPort& port : ports_) port.read_from_host();
  do_periodic_work();
  report_progress();
  pump();
  io_.run();
  save_state();

  std::vector<std::pair<std::string, Tally>> tallies;
  unsigned number = 0;
  bool is_one_gone = false;
  for (const Robot& robot : network_.robots()) {
    is_one_gone = is_one_gone || robot.tally().failed_assertions > 0;
    tallies.emplace_back(options_.common.id_of(++number), robot.tally());
  }
  fmt::print("{}\n", to_json(tallies));
  return is_one_gone ? robot_is_gone : 0;
}

void SerialSide::wait_signal() {
  signals_.async_wait([this](error_code error, int signal) {
    if (error) return;
    on_signal(signal);
    wait_signal();
  });
}

void SerialSide::on_signal(int signal) {
  if (signal == SIGUSR1) return ports_[power_cycled_++ % ports_.size()].power_cycle_board();
  if (signal == SIGUSR2) return ports_[restarted_++ % ports_.size()].restart_board();
  io_.stop();
}

void SerialSide::pump() {
  write_record();
  report_failed_assertions();
  flush_to_hosts();
  while (network_.deadline() <= std::chrono::steady_clock::now()) {
    network_.on_deadline(std::chrono::steady_clock::now());
    write_record();
    report_failed_assertions();
    flush_to_hosts();
  }
  finish_when_done();
  next_event_.expires_at(network_.deadline());
  next_event_.async_wait([this](error_code error) {
    if (!error) pump();
  });
}

void SerialSide::flush_to_hosts() {
  for (BoardPort& port : ports_) port.flush_to_host();
}

void SerialSide::write_record() {
  while (const auto event = network_.next_event()) {
    record_.write(options_.common.id_of(event->first), event->second);
  }
}

void SerialSide::report_failed_assertions() {
  while (const auto failed = network_.next_failed_assertion()) {
    fmt::print(stderr, "{} has failed an assertion and is gone: {}\n",
               options_.common.id_of(failed->first), failed->second);
  }
}

void SerialSide::do_periodic_work() {
  for (BoardPort& port : ports_) port.allow_next_host();
  save_state();
  periodic_.expires_after(periodic_interval);
  periodic_.async_wait([this](error_code error) {
    if (!error) do_periodic_work();
  });
}

void SerialSide::save_state() {
  if (options_.state.empty()) return;
  std::string state = state_of(network_);
  if (state == saved_state_) return;
  write_state(options_.state, state);
  saved_state_ = std::move(state);
}

void SerialSide::report_progress() {
  progress_.expires_after(progress_interval);
  progress_.async_wait([this](error_code error) {
    if (error) return;
    std::uint64_t sent = 0;
    for (const Robot& robot : network_.robots()) sent += robot.tally().sent;
    if (network_.has_begun()) {
      fmt::print(stderr, "{} updates sent\n", sent);
    } else {
      fmt::print(stderr, "waiting for a host to set up the board\n");
    }
    report_progress();
  });
}

void SerialSide::finish_when_done() {
  if (is_ending_ || !network_.has_sent_everything()) return;
  is_ending_ = true;
  end_.expires_after(options_.common.linger());
  end_.async_wait([this](error_code error) {
    if (!error) drain(drain_steps, 0);
  });
}

/// Waits for the host, as closing a pty discards unread octets. Ends when three checks in a row
/// find none.
void SerialSide::drain(int steps_left, int quiet_steps) {
  const bool is_quiet = std::all_of(ports_.begin(), ports_.end(),
                                    [](const BoardPort& port) { return port.is_quiet(); });
  quiet_steps = is_quiet ? quiet_steps + 1 : 0;
  if (quiet_steps >= 3 || steps_left == 0) return io_.stop();
  end_.expires_after(drain_step);
  end_.async_wait([this, steps_left, quiet_steps](error_code error) {
    if (!error) drain(steps_left - 1, quiet_steps);
  });
}

}  // namespace

int run_serial_side(const BleOptions& options) {
  try {
    return SerialSide(options).run();
  } catch (const std::runtime_error& error) {  // system errors, too
    fmt::print(stderr, "slam-gateway-sim: {}\n", error.what());
    return no_terminal;
  }
}

}  // namespace slamgw::sim::ble
