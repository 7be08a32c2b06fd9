// SPDX-License-Identifier: Apache-2.0
// The Unix socket that slam-gatewayctl talks to: accepts clients and hands traffic to the watching
// ones. The ControlHandler answers their requests. On the loop's thread only; a slow or silent
// client costs bounded memory and never blocks the loop.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "daemon/control/control_handler.hpp"
#include "daemon/core/messages.hpp"
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

class ControlServer {
 public:
  /// `handler` must outlive the server.
  ControlServer(boost::asio::io_context& io, std::string path, ControlHandler& handler,
                ControlLimits limits = {});
  /// Calls stop().
  ~ControlServer();
  ControlServer(const ControlServer&) = delete;
  ControlServer& operator=(const ControlServer&) = delete;

  /// Replaces a socket that a dead daemon has left. Throws std::runtime_error that names the fault:
  /// another daemon answers there, the directory can't be written, ...
  void start();
  /// Ends all clients and removes the socket. Does not call the handler, then or later.
  void stop();

  bool has_watchers() const { return watchers() > 0; }
  /// Sends the event to the watchers that want it. A watcher that is too slow loses events and gets
  /// the number of these.
  void publish(const TraceEvent& event);
  Counters counters() const;

 private:
  using Socket = boost::asio::local::stream_protocol::socket;
  class Session;

  struct Counts {
    std::uint64_t clients = 0;
    std::uint64_t clients_refused = 0;
    std::uint64_t watchers_dropped = 0;
    std::uint64_t events_lost = 0;
    std::uint64_t bad_requests = 0;
    std::uint64_t requests_dropped = 0;  ///< the client was gone before its request was read
  };

  std::size_t watchers() const;
  void accept();
  void on_accept(boost::system::error_code error, Socket socket);
  void admit(Socket socket);
  void remove(const Session& ended);
  void report_whether_watched();

  boost::asio::io_context& io_;
  boost::asio::local::stream_protocol::acceptor acceptor_;
  Timer retry_timer_;
  std::string path_;
  ControlHandler& handler_;
  const ControlLimits limits_;
  Counts counts_;
  std::vector<std::shared_ptr<Session>> sessions_;
  bool was_watched_ = false;
  /// Reset by stop(), so that a completion that is already under way does not touch the server.
  std::shared_ptr<const int> alive_ = std::make_shared<int>();
};

}  // namespace slamgw
