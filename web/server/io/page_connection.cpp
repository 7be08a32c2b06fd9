// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/page_connection.hpp"

#include <boost/asio/buffer.hpp>
#include <boost/asio/post.hpp>
#include <utility>

#include "daemon/observability/log.hpp"
#include "web/server/answers.hpp"

namespace slamgw::web {
namespace {

namespace beast = boost::beast;
namespace websocket = boost::beast::websocket;

constexpr std::chrono::seconds handshake_limit{10};

}  // namespace

PageConnection::PageConnection(beast::tcp_stream stream, PageHub& hub, const Client& client,
                               HeldPlace place)
    : socket_(std::move(stream)),
      hub_(hub),
      place_(std::move(place)),
      page_place_(hub.places().take(client)),
      session_(hub.new_session(client)),
      delay_(socket_.get_executor()) {
  beast::get_lowest_layer(socket_).expires_never();  // the WebSocket has limits of its own
  socket_.set_option(websocket::stream_base::timeout{handshake_limit, silence_limit, true});
  socket_.set_option(websocket::stream_base::decorator([](websocket::response_type& response) {
    for (const auto& [name, value] : safety_headers())
      response.insert({name.data(), name.size()}, {value.data(), value.size()});
  }));
  socket_.read_message_max(max_page_message);
  socket_.auto_fragment(false);  // fragments would cost a system call for each 4 KiB
}

PageConnection::~PageConnection() { hub_.leave(*this); }

void PageConnection::accept(const beast::http::request<beast::http::empty_body>& request) {
  socket_.async_accept(request, [self = shared_from_this()](beast::error_code error) {
    if (error) return;
    self->is_open_ = true;
    self->socket_.text(true);
    if (!self->session_.may_watch())
      self->send_state("$web/hello",
                       std::make_shared<const std::string>(PageHub::locked_greeting()));
    self->follow_token();
    self->read();
  });
}

void PageConnection::read() {
  socket_.async_read(input_, [self = shared_from_this()](beast::error_code error, std::size_t) {
    if (error) return self->close();
    const std::string text = beast::buffers_to_string(self->input_.data());
    self->input_.consume(self->input_.size());
    self->on_text(text);
    if (!self->ends_) self->read();
  });
}

void PageConnection::on_text(const std::string& text) {
  PageSession::Reaction reaction = session_.on_text(text, std::chrono::steady_clock::now());
  if (!reaction.report.empty()) log_event(Severity::warning, reaction.report);
  if (reaction.drops_delayed_reply) {
    late_.reset();
    delay_.cancel();
  }
  if (reaction.publish) reaction.reply = hub_.publish(*reaction.publish);
  for (const std::string& robot : reaction.history)
    send_state("$web/history/" + robot, hub_.history_of(robot));
  if (reaction.past_since_ms)
    for (const auto& [topic, past] : hub_.past(*reaction.past_since_ms)) send_state(topic, past);
  if (reaction.delay > std::chrono::seconds{0})
    answer_later(std::move(reaction));
  else
    answer(std::move(reaction));
  follow_token();
}

void PageConnection::follow_token() {
  if (session_.may_watch())
    hub_.join(*this);
  else
    hub_.leave(*this);
}

/// Delays only the answer. Reading continues: the WebSocket stays alive, and a right token gets its
/// answer first. The timer keeps this object and its places, even when the connection breaks.
void PageConnection::answer_later(PageSession::Reaction reaction) {
  const auto delay = reaction.delay;
  late_ = std::move(reaction);
  delay_.after(delay, [self = shared_from_this()] {
    if (self->late_) self->answer(*std::exchange(self->late_, std::nullopt));
  });
}

void PageConnection::answer(PageSession::Reaction reaction) {
  ends_ = ends_ || reaction.ends;
  if (!reaction.reply.empty())
    send_event(std::make_shared<const std::string>(std::move(reaction.reply)));
}

void PageConnection::send_state(std::string_view topic, const SharedText& text) {
  if (!queue_.push_state(topic, text)) give_up();
  write_soon();
}

void PageConnection::send_reset(std::string_view topic, const SharedText& text) {
  queue_.reset(topic, text);
  write_soon();
}

void PageConnection::send_event(const SharedText& text) {
  hub_.count_dropped(queue_.push_event(text));
  write_soon();
}

/// Posts the write, so that it includes all messages of this turn of the loop.
void PageConnection::write_soon() {
  if (!writing_.empty() || std::exchange(is_write_posted_, true)) return;
  boost::asio::post(socket_.get_executor(), [self = shared_from_this()] {
    self->is_write_posted_ = false;
    self->write();
  });
}

void PageConnection::write() {
  if (!writing_.empty() || !is_open_) return;
  writing_ = queue_.take();
  if (writing_.empty()) {
    if (ends_) close();
    return;
  }
  socket_.async_write(boost::asio::buffer(writing_),
                      [self = shared_from_this()](beast::error_code error, std::size_t) {
                        self->writing_ = {};
                        if (error) return self->close();
                        self->write();
                      });
}

/// Posts the close, because the hub may be iterating over its pages now.
void PageConnection::give_up() {
  boost::asio::post(socket_.get_executor(), [self = shared_from_this()] { self->close(); });
}

/// Leaves the hub at once. Operations under way end with an error; the last one destroys the
/// connection.
void PageConnection::close() {
  is_open_ = false;
  hub_.leave(*this);
  beast::get_lowest_layer(socket_).close();
}

}  // namespace slamgw::web
