// SPDX-License-Identifier: Apache-2.0
// The WebSocket of one page (RFC 6455, Boost.Beast). Lives as long as its connection. One write is
// under way at a time; other messages wait in a PageQueue. Messages of one turn of the loop go out
// in one WebSocket message.
#pragma once

#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <memory>
#include <optional>

#include "daemon/runtime/timer.hpp"
#include "web/server/io/page_hub.hpp"
#include "web/server/page_queue.hpp"

namespace slamgw::web {

class PageConnection : public std::enable_shared_from_this<PageConnection> {
 public:
  /// A page that does not react for this long is gone.
  static constexpr std::chrono::seconds silence_limit{30};

  /// `place`: the connection's. Also takes a page's place, which the caller has found free.
  PageConnection(boost::beast::tcp_stream stream, PageHub& hub, const Client& client,
                 HeldPlace place);
  ~PageConnection();

  void accept(const boost::beast::http::request<boost::beast::http::empty_body>& request);
  void send_state(std::string_view topic, const SharedText& text);
  /// Drops the waiting states; all states are sent again after this one.
  void send_reset(std::string_view topic, const SharedText& text);
  void send_event(const SharedText& text);

 private:
  void read();
  void on_text(const std::string& text);
  void follow_token();
  void answer_later(PageSession::Reaction reaction);
  void answer(PageSession::Reaction reaction);
  void write_soon();
  void write();
  void give_up();
  void close();

  boost::beast::websocket::stream<boost::beast::tcp_stream> socket_;
  PageHub& hub_;
  const HeldPlace place_;
  const HeldPlace page_place_;
  PageSession session_;
  Timer delay_;  ///< delays the answer to a wrong token
  std::optional<PageSession::Reaction> late_;
  PageQueue queue_;
  std::string writing_;
  boost::beast::flat_buffer input_;
  bool is_open_ = false;
  bool is_write_posted_ = false;
  bool ends_ = false;
};

}  // namespace slamgw::web
