// SPDX-License-Identifier: Apache-2.0
// One HTTP connection: reads requests one after the other, answers each, and hands the stream to a
// PageConnection when a request asks for the WebSocket. Lives while an operation is under way.
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <memory>
#include <optional>

#include "daemon/runtime/timer.hpp"
#include "web/server/answers.hpp"
#include "web/server/io/web_server.hpp"

namespace slamgw::web {

class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
 public:
  static constexpr std::chrono::seconds idle_limit{20};
  static constexpr unsigned max_header_bytes = 8192;

  /// Takes a place, which the caller has found free.
  HttpConnection(boost::asio::ip::tcp::socket socket, WebServer& server, const Client& client);
  void read();

 private:
  using Parser = boost::beast::http::request_parser<boost::beast::http::empty_body>;
  using Response = boost::beast::http::response<boost::beast::http::string_body>;

  void on_request(bool is_readable);
  /// Hands the stream to a PageConnection if there is room; else makes `answer` a refusal.
  bool becomes_page(Answer& answer);
  /// Metrics need a token where watching needs one.
  bool may_read_metrics();
  void refuse_metrics();
  void send_metrics(Answer answer);
  void send(Answer answer);
  void on_sent();

  boost::beast::tcp_stream stream_;
  WebServer& server_;
  const Client client_;
  Timer delay_;  ///< delays the answer to a wrong token
  const HeldPlace place_;
  boost::beast::flat_buffer input_;
  std::optional<Parser> parser_;
  Response response_;
  std::shared_ptr<void> scrape_;  ///< a place, while the answer is made of metrics
};

}  // namespace slamgw::web
