// SPDX-License-Identifier: Apache-2.0
// The listening socket and its HTTP connections (Boost.Beast). The answers: answers.hpp; a
// connection that becomes a WebSocket: page_connection.hpp.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <string>

#include "daemon/runtime/timer.hpp"
#include "web/server/answers.hpp"
#include "web/server/io/page_hub.hpp"

namespace slamgw::web {

class WebServer {
 public:
  /// All connections, including pages; a browser opens up to six for the files.
  static constexpr std::size_t max_connections = 256;

  /// Listens; throws boost::system::system_error when it cannot.
  WebServer(boost::asio::io_context& io, const Settings& settings, PageHub& hub);

  /// The address in use; where `listen` has port 0, the system chose one.
  std::string address() const;
  const Answers& answers() const { return answers_; }
  PageHub& hub() { return hub_; }
  Places& places() { return places_; }

 private:
  void accept();
  void admit(boost::asio::ip::tcp::socket socket);

  PageHub& hub_;
  Answers answers_;
  boost::asio::ip::tcp::acceptor acceptor_;
  Timer pause_;  ///< after a failure, such as too many open files
  Places places_{max_connections};
};

}  // namespace slamgw::web
