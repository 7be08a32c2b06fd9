// SPDX-License-Identifier: Apache-2.0
// The Unix socket that slam-gatewayctl talks to: accepts clients and hands traffic to the watching
// ones. The ControlHandler answers their requests. On the loop's thread only; a slow or silent
// client costs bounded memory and never blocks the loop.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <memory>
#include <string>
#include <vector>

#include "daemon/control/control_handler.hpp"
#include "daemon/control/control_session.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

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
  std::size_t watchers() const;
  void accept();
  void on_accept(boost::system::error_code error, ControlSession::Socket socket);
  void admit(ControlSession::Socket socket);
  void report_whether_watched();

  boost::asio::io_context& io_;
  boost::asio::local::stream_protocol::acceptor acceptor_;
  Timer retry_timer_;
  std::string path_;
  ControlHandler& handler_;
  const ControlLimits limits_;
  ControlCounters counters_;
  std::vector<std::shared_ptr<ControlSession>> sessions_;
  bool was_watched_ = false;
  /// Reset by stop(), so that a completion that is already under way does not touch the server.
  std::shared_ptr<const int> alive_ = std::make_shared<int>();
};

}  // namespace slamgw
