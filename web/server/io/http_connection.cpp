// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/http_connection.hpp"

#include <utility>

#include "daemon/observability/log.hpp"
#include "web/server/io/page_connection.hpp"

namespace slamgw::web {
namespace {

namespace beast = boost::beast;
namespace http = boost::beast::http;

std::string_view view(beast::string_view text) { return {text.data(), text.size()}; }

Request request_of(const http::request<http::empty_body>& message) {
  return {view(message.method_string()),
          view(message.target()),
          view(message[http::field::host]),
          view(message[http::field::origin]),
          view(message[http::field::accept_encoding]),
          view(message[http::field::if_none_match]),
          beast::websocket::is_upgrade(message)};
}

bool is_malformed(beast::error_code error) {
  return error.category() == beast::error_code(http::error::bad_version).category() &&
         error != http::error::end_of_stream && error != http::error::partial_message;
}

}  // namespace

HttpConnection::HttpConnection(boost::asio::ip::tcp::socket socket, WebServer& server,
                               const Client& client)
    : stream_(std::move(socket)),
      server_(server),
      client_(client),
      delay_(stream_.get_executor()),
      place_(server.places().take(client)) {
  beast::error_code ignored;
  stream_.socket().set_option(boost::asio::ip::tcp::no_delay(true), ignored);
}

void HttpConnection::read() {
  parser_.emplace();
  parser_->header_limit(max_header_bytes);
  stream_.expires_after(idle_limit);
  server_.places().set_waiting(place_, [this] { stream_.close(); });
  http::async_read_header(stream_, input_, *parser_,
                          [self = shared_from_this()](beast::error_code error, std::size_t) {
                            if (!error || is_malformed(error)) self->on_request(!error);
                          });
}

void HttpConnection::on_request(bool is_readable) {
  server_.places().set_waiting(place_, nullptr);
  Answer answer = is_readable ? server_.answers().to(request_of(parser_->get()))
                              : refuse(400, "This is not an HTTP request.");
  // RFC 9112 section 3.2. A body is not read, so the connection ends with the answer.
  const bool is_wrong = !parser_->is_done() || parser_->get().count(http::field::host) > 1;
  if (is_wrong && answer.status < 400)
    answer = refuse(400, "A request here has one Host and no body.");
  if (answer.is_web_socket && becomes_page(answer)) return;
  if (answer.is_metrics && !may_read_metrics()) return refuse_metrics();
  if (answer.is_metrics) {
    scrape_ = server_.hub().begin_scrape();
    if (scrape_) return send_metrics(std::move(answer));
    answer = refuse(503, "Too many clients read the metrics at once.");
  }
  if (answer.status >= 400) server_.hub().count_refused_request();
  send(std::move(answer));
}

bool HttpConnection::may_read_metrics() {
  if (!server_.hub().tokens().guard_watching()) return true;
  const std::string_view token = bearer_token(view(parser_->get()[http::field::authorization]));
  if (!server_.hub().tokens().find(token)) return false;
  server_.hub().guesses().forget(client_);
  return true;
}

void HttpConnection::refuse_metrics() {
  server_.hub().count_refused_request();
  const bool is_guess = parser_->get().count(http::field::authorization) > 0;
  const TokenGuesses::Cost cost =
      is_guess ? server_.hub().guesses().on_wrong(client_, std::chrono::steady_clock::now())
               : TokenGuesses::Cost{};
  if (!cost.report.empty()) log_event(Severity::warning, cost.report);
  delay_.after(cost.delay, [self = shared_from_this()] {
    self->send(refuse(401, "The metrics need a token: Authorization: Bearer TOKEN"));
  });
}

bool HttpConnection::becomes_page(Answer& answer) {
  PageHub& hub = server_.hub();
  const Places::Room room = hub.places().room_for(client_);
  if (room == Places::Room::free) {
    std::make_shared<PageConnection>(std::move(stream_), hub, client_, place_)
        ->accept(parser_->get());
    return true;
  }
  answer = refuse(503, "Too many pages are open.");
  if (room == Places::Room::share_is_taken) {
    answer = refuse(503, "Too many pages are open from this address.");
    hub.report_taken_share(client_);
  }
  return false;
}

void HttpConnection::send_metrics(Answer answer) {
  server_.hub().make_metrics(
      [self = shared_from_this(), answer = std::move(answer)](std::string text) mutable {
        answer.text = std::move(text);
        self->send(std::move(answer));
      });
}

void HttpConnection::send(Answer answer) {
  const auto& request = parser_->get();
  response_ = Response{http::int_to_status(answer.status), request.version()};
  for (const auto& [name, value] : safety_headers())
    response_.insert({name.data(), name.size()}, {value.data(), value.size()});
  const auto set = [this](http::field field, std::string_view value) {
    if (!value.empty()) response_.set(field, {value.data(), value.size()});
  };
  set(http::field::content_type, answer.content_type);
  set(http::field::www_authenticate, answer.status == 401 ? "Bearer" : "");
  set(http::field::cache_control, answer.etag.empty() ? "no-store" : "no-cache");
  set(http::field::etag, answer.etag);
  set(http::field::vary, answer.etag.empty() ? "" : "Accept-Encoding");
  set(http::field::content_encoding, answer.is_gzip && !answer.file.empty() ? "gzip" : "");
  const bool is_file = !answer.file.empty();
  const std::size_t size = is_file ? answer.file.size() : answer.text.size();
  if (request.method() != http::verb::head)
    response_.body() = is_file ? std::string(answer.file) : std::move(answer.text);
  response_.keep_alive(request.keep_alive() && answer.status < 400);
  if (answer.status != 304) response_.content_length(size);
  stream_.expires_after(idle_limit);
  http::async_write(stream_, response_,
                    [self = shared_from_this()](beast::error_code error, std::size_t) {
                      if (!error) self->on_sent();
                    });
}

void HttpConnection::on_sent() {
  const bool goes_on = response_.keep_alive();
  response_ = {};  // metrics are large
  scrape_.reset();
  if (goes_on) return read();
  beast::error_code ignored;
  stream_.socket().shutdown(boost::asio::ip::tcp::socket::shutdown_send, ignored);
}

}  // namespace slamgw::web
