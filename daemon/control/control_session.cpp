// SPDX-License-Identifier: Apache-2.0
#include "daemon/control/control_session.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <nlohmann/json.hpp>

#include <boost/asio/buffer.hpp>
#include <boost/asio/error.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <utility>

#include "daemon/observability/audit_notice.hpp"

namespace slamgw {

namespace asio = boost::asio;
using boost::system::error_code;

namespace {

/// Names the client's user, as the kernel reports it.
std::string peer_of(int socket) {
  ucred peer{};
  socklen_t size = sizeof peer;
  if (getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) return "uid unknown";
  return user_words(peer.uid);
}

/// Returns whether the client has closed its end. A client that has only shut down its sending half
/// waits for its answer: poll(2) then reports POLLRDHUP alone.
bool is_client_gone(int socket) {
  pollfd client{socket, 0, 0};
  return poll(&client, 1, 0) > 0 && (client.revents & POLLHUP) != 0;
}

}  // namespace

ControlSession::ControlSession(Socket socket, const ControlLimits& limits,
                               ControlCounters& counters, ControlHandler& handler,
                               std::function<bool()> may_watch, std::function<void()> on_watch,
                               std::function<void(ControlSession&)> on_end)
    : socket_(std::move(socket)),
      who_(peer_of(socket_.native_handle())),
      idle_timer_(socket_.get_executor()),
      limits_(limits),
      counters_(counters),
      handler_(handler),
      may_watch_(std::move(may_watch)),
      on_watch_(std::move(on_watch)),
      on_end_(std::move(on_end)) {}

void ControlSession::start() { read_line(); }

void ControlSession::close() {
  is_closed_ = true;
  error_code ignored;
  socket_.close(ignored);
  idle_timer_.cancel();
}

bool ControlSession::wants(const TraceEvent& event) const {
  return watch_ && (!watch_->robot || *watch_->robot == event.robot) &&
         (!watch_->type || *watch_->type == event.type);
}

void ControlSession::offer_event(const std::string& line, WallTime at) {
  report_lost();
  if (lost_ > 0 || queued() + line.size() > limits_.queued_bytes) {
    ++counters_.events_lost;
    ++lost_;
    lost_at_ = at;
    return;
  }
  waiting_ += line;
  write_waiting();
}

void ControlSession::report_lost() {
  if (lost_ == 0 || queued() > limits_.queued_bytes / 2) return;
  waiting_ += control::lost_line(std::exchange(lost_, 0), lost_at_);
  write_waiting();
}

void ControlSession::read_line() {
  arm_idle_timer();
  asio::async_read_until(socket_, asio::dynamic_buffer(input_, limits_.request_bytes), '\n',
                         [self = shared_from_this()](error_code error, std::size_t size) {
                           if (!self->is_closed_) self->on_line(error, size);
                         });
}

void ControlSession::on_line(error_code error, std::size_t size) {
  if (error == asio::error::not_found) {
    ++counters_.bad_requests;
    ends_after_answer_ = true;
    return answer(control::error_line("the request is longer than " +
                                      std::to_string(limits_.request_bytes) + " bytes"));
  }
  if (error) return end();
  const std::string line = input_.substr(0, size - 1);
  input_.erase(0, size);
  idle_timer_.cancel();  // the order may take any time
  handle(line);
  // The next request is read after this answer is written, so that answers can't pile up. A watcher
  // is always read, which shows when it disconnects.
  if (watch_ && !is_closed_) read_line();
}

void ControlSession::handle(const std::string& line) {
  auto request = control::parse_request(line);
  if (!request) {
    ++counters_.bad_requests;
    return answer(control::error_line(request.error()));
  }
  if (is_client_gone(socket_.native_handle())) {  // its user took the request for failed
    ++counters_.requests_dropped;
    return end();
  }
  if (auto* watch = std::get_if<control::WatchRequest>(&*request)) {
    if (!watch_ && !may_watch_()) {
      ++counters_.clients_refused;
      return answer(control::error_line(std::to_string(limits_.watchers) +
                                        " clients watch already, which is the limit: "
                                        "end a slam-gatewayctl watch, record or check first"));
    }
    answer(control::result_line("watching"));
    watch_ = std::move(*watch);
    return on_watch_();
  }
  handler_.on_request(who_, std::move(*request),
                      [self = weak_from_this()](const std::string& answered) {
                        const auto session = self.lock();
                        if (session && !session->is_closed_) session->answer(answered);
                      });
}

void ControlSession::answer(const std::string& line) {
  // A watcher's answers and events share one bound.
  if (watch_ && queued() + line.size() > limits_.queued_bytes) {
    ++counters_.watchers_dropped;
    return end();
  }
  arm_idle_timer();
  waiting_ += line;
  write_waiting();
}

void ControlSession::write_waiting() {
  if (!writing_.empty() || waiting_.empty()) return;
  writing_ = std::exchange(waiting_, {});
  asio::async_write(socket_, asio::buffer(writing_),
                    [self = shared_from_this()](error_code error, std::size_t) {
                      if (!self->is_closed_) self->on_written(error);
                    });
}

void ControlSession::on_written(error_code error) {
  writing_.clear();
  if (error) return end();
  report_lost();
  if (!waiting_.empty()) return write_waiting();
  if (ends_after_answer_) return end();
  if (!watch_) read_line();
}

void ControlSession::arm_idle_timer() {
  if (watch_) return idle_timer_.cancel();
  idle_timer_.after(limits_.idle, [self = shared_from_this()] { self->end(); });
}

void ControlSession::end() {
  close();
  on_end_(*this);
}

}  // namespace slamgw
