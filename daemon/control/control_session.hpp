// SPDX-License-Identifier: Apache-2.0
// One client of the control socket: reads its requests one by one, writes the answers and, to a
// watcher, events. Made and held by ControlServer; keeps itself alive while operations are under
// way and calls nothing after close().
#pragma once

#include <boost/asio/local/stream_protocol.hpp>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "daemon/control/control_handler.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

struct ControlLimits {
  std::size_t clients = 32;
  /// Watchers stay, so they may take only part of the places, and requests find room.
  std::size_t watchers = 24;
  /// A longer line ends its client. A database of 256 nodes to import has half this size.
  std::size_t request_bytes = std::size_t{1024} * 1024;
  /// The most that may wait for a watcher. Beyond it, events are lost, and a watcher that sends
  /// requests without reading the answers is cut off.
  std::size_t queued_bytes = std::size_t{1024} * 1024;
  /// A client is cut off when it is silent or does not read its answer for this long. Watchers are
  /// not, nor clients whose order is under way.
  std::chrono::milliseconds idle{60000};
};

struct ControlCounters {
  std::uint64_t clients = 0;
  std::uint64_t clients_refused = 0;
  std::uint64_t watchers_dropped = 0;
  std::uint64_t events_lost = 0;
  std::uint64_t bad_requests = 0;
  std::uint64_t requests_dropped = 0;  ///< the client was gone before its request was read
};

class ControlSession : public std::enable_shared_from_this<ControlSession> {
 public:
  using Socket = boost::asio::local::stream_protocol::socket;

  /// `may_watch` is asked before the client begins to watch, and `on_watch` called then. `on_end`
  /// is called once, when the client has disconnected or was cut off; close() does not call it.
  ControlSession(Socket socket, const ControlLimits& limits, ControlCounters& counters,
                 ControlHandler& handler, std::function<bool()> may_watch,
                 std::function<void()> on_watch, std::function<void(ControlSession&)> on_end);

  void start();
  void close();
  bool wants(const TraceEvent& event) const;
  bool is_watching() const { return watch_.has_value(); }
  /// Queues an event for a watcher, or counts it as lost when too much waits already. The number of
  /// lost events is sent as soon as half of the room is free.
  void offer_event(const std::string& line, WallTime at);

 private:
  void read_line();
  void on_line(boost::system::error_code error, std::size_t size);
  void handle(const std::string& line);
  /// Queues an answer, or cuts a watcher off when too much waits for it already.
  void answer(const std::string& line);
  void report_lost();
  std::size_t queued() const { return writing_.size() + waiting_.size(); }
  void on_written(boost::system::error_code error);
  void write_waiting();
  void arm_idle_timer();
  void end();

  Socket socket_;
  const std::string who_;
  Timer idle_timer_;
  const ControlLimits& limits_;
  ControlCounters& counters_;
  ControlHandler& handler_;
  std::function<bool()> may_watch_;
  std::function<void()> on_watch_;
  std::function<void(ControlSession&)> on_end_;

  std::string input_;
  std::string writing_;  // being written
  std::string waiting_;  // to be written next
  std::optional<control::WatchRequest> watch_;
  std::uint64_t lost_ = 0;  // lost events that are not reported yet
  WallTime lost_at_{};
  bool ends_after_answer_ = false;
  bool is_closed_ = false;
};

}  // namespace slamgw
