// SPDX-License-Identifier: Apache-2.0
#include "daemon/control/control_server.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <boost/asio/buffer.hpp>
#include <boost/asio/error.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "daemon/observability/audit_notice.hpp"

namespace slamgw {

namespace asio = boost::asio;
using boost::asio::local::stream_protocol;
using boost::system::error_code;

namespace {

constexpr mode_t socket_mode = 0660;  // the group of the service's user may use it
constexpr std::chrono::seconds accept_retry{1};

[[noreturn]] void fail(const std::string& path, const std::string& why) {
  throw std::runtime_error("control socket " + path + ": " + why + "; see control.socket");
}

void make_directory(const std::string& path) {
  const auto directory = std::filesystem::path(path).parent_path();
  std::error_code error;
  if (!directory.empty()) std::filesystem::create_directories(directory, error);
  if (error) fail(path, "its directory can't be made: " + error.message());
}

/// Removes a socket without a listener. Leaves any other file alone.
void remove_stale(asio::io_context& io, const std::string& path) {
  struct stat status {};
  if (lstat(path.c_str(), &status) != 0) return;
  if (!S_ISSOCK(status.st_mode)) fail(path, "a file that is not a socket is in its place");
  stream_protocol::socket probe(io);
  error_code error;
  probe.open();
  probe.non_blocking(true);  // a living daemon with a full backlog must not hold us up
  probe.connect(stream_protocol::endpoint(path), error);
  if (!error || error == asio::error::would_block || error == asio::error::try_again)
    fail(path, "another slam-gatewayd answers there");
  if (error == asio::error::connection_refused) unlink(path.c_str());
}

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

/// One client: reads its requests one by one, writes the answers and, to a watcher, events. Keeps
/// itself alive while operations are under way, and calls nothing after close().
class ControlServer::Session : public std::enable_shared_from_this<Session> {
 public:
  Session(Socket socket, ControlServer& server)
      : socket_(std::move(socket)),
        who_(peer_of(socket_.native_handle())),
        idle_timer_(socket_.get_executor()),
        server_(server),
        limits_(server.limits_),
        counts_(server.counts_) {}

  void read_line() {
    arm_idle_timer();
    asio::async_read_until(socket_, asio::dynamic_buffer(input_, limits_.request_bytes), '\n',
                           [self = shared_from_this()](error_code error, std::size_t size) {
                             if (!self->is_closed_) self->on_line(error, size);
                           });
  }

  void close() {
    is_closed_ = true;
    error_code ignored;
    socket_.close(ignored);
    idle_timer_.cancel();
  }

  bool is_watching() const { return watch_.has_value(); }

  bool wants(const TraceEvent& event) const {
    return watch_ && (!watch_->robot || *watch_->robot == event.robot) &&
           (!watch_->type || *watch_->type == event.type);
  }

  /// Queues an event for a watcher, or counts it as lost when too much waits already. The number of
  /// lost events is sent as soon as half of the room is free.
  void offer_event(const std::string& line, WallTime at) {
    report_lost();
    if (lost_ > 0 || queued() + line.size() > limits_.queued_bytes) {
      ++counts_.events_lost;
      ++lost_;
      lost_at_ = at;
      return;
    }
    waiting_ += line;
    write_waiting();
  }

 private:
  void on_line(error_code error, std::size_t size) {
    if (error == asio::error::not_found) {
      ++counts_.bad_requests;
      ends_after_answer_ = true;
      return answer(control::error_line("the request is longer than " +
                                        std::to_string(limits_.request_bytes) + " bytes"));
    }
    if (error) return end();
    const std::string line = input_.substr(0, size - 1);
    input_.erase(0, size);
    idle_timer_.cancel();  // the order may take any time
    handle(line);
    // The next request is read after this answer is written, so that answers can't pile up. A
    // watcher is always read, which shows when it disconnects.
    if (watch_ && !is_closed_) read_line();
  }

  void handle(const std::string& line) {
    auto request = control::parse_request(line);
    if (!request) {
      ++counts_.bad_requests;
      return answer(control::error_line(request.error()));
    }
    if (is_client_gone(socket_.native_handle())) {  // its user took the request for failed
      ++counts_.requests_dropped;
      return end();
    }
    if (auto* watch = std::get_if<control::WatchRequest>(&*request)) {
      if (!watch_ && server_.watchers() >= limits_.watchers) {
        ++counts_.clients_refused;
        return answer(control::error_line(std::to_string(limits_.watchers) +
                                          " clients watch already, which is the limit: "
                                          "end a slam-gatewayctl watch, record or check first"));
      }
      answer(control::result_line("watching"));
      watch_ = std::move(*watch);
      return server_.report_whether_watched();
    }
    server_.handler_.on_request(who_, std::move(*request),
                                [self = weak_from_this()](const std::string& answered) {
                                  const auto session = self.lock();
                                  if (session && !session->is_closed_) session->answer(answered);
                                });
  }

  /// Queues an answer, or cuts a watcher off when too much waits for it already.
  void answer(const std::string& line) {
    // A watcher's answers and events share one bound.
    if (watch_ && queued() + line.size() > limits_.queued_bytes) {
      ++counts_.watchers_dropped;
      return end();
    }
    arm_idle_timer();
    waiting_ += line;
    write_waiting();
  }

  void report_lost() {
    if (lost_ == 0 || queued() > limits_.queued_bytes / 2) return;
    waiting_ += control::lost_line(std::exchange(lost_, 0), lost_at_);
    write_waiting();
  }

  std::size_t queued() const { return writing_.size() + waiting_.size(); }

  void write_waiting() {
    if (!writing_.empty() || waiting_.empty()) return;
    writing_ = std::exchange(waiting_, {});
    asio::async_write(socket_, asio::buffer(writing_),
                      [self = shared_from_this()](error_code error, std::size_t) {
                        if (!self->is_closed_) self->on_written(error);
                      });
  }

  void on_written(error_code error) {
    writing_.clear();
    if (error) return end();
    report_lost();
    if (!waiting_.empty()) return write_waiting();
    if (ends_after_answer_) return end();
    if (!watch_) read_line();
  }

  void arm_idle_timer() {
    if (watch_) return idle_timer_.cancel();
    idle_timer_.after(limits_.idle, [self = shared_from_this()] { self->end(); });
  }

  void end() {
    close();
    server_.remove(*this);
  }

  Socket socket_;
  const std::string who_;
  Timer idle_timer_;
  ControlServer& server_;
  const ControlLimits& limits_;
  Counts& counts_;

  std::string input_;
  std::string writing_;  // being written
  std::string waiting_;  // to be written next
  std::optional<control::WatchRequest> watch_;
  std::uint64_t lost_ = 0;  // lost events that are not reported yet
  WallTime lost_at_{};
  bool ends_after_answer_ = false;
  bool is_closed_ = false;
};

ControlServer::ControlServer(asio::io_context& io, std::string path, ControlHandler& handler,
                             ControlLimits limits)
    : io_(io),
      acceptor_(io),
      retry_timer_(io),
      path_(std::move(path)),
      handler_(handler),
      limits_(limits) {}

ControlServer::~ControlServer() { stop(); }

void ControlServer::start() {
  make_directory(path_);
  remove_stale(io_, path_);
  acceptor_.open(stream_protocol());
  // Set before bind() makes the file, so that other users can't open it at any time.
  fchmod(acceptor_.native_handle(), socket_mode);
  error_code error;
  acceptor_.bind(stream_protocol::endpoint(path_), error);
  if (error) {
    acceptor_.close();
    fail(path_, "can't be made: " + error.message());
  }
  chmod(path_.c_str(), socket_mode);  // restores what the umask removed
  acceptor_.listen();
  accept();
}

void ControlServer::stop() {
  alive_.reset();
  for (const auto& session : std::exchange(sessions_, {})) session->close();
  retry_timer_.cancel();
  if (!acceptor_.is_open()) return;
  error_code ignored;
  acceptor_.close(ignored);
  unlink(path_.c_str());
}

std::size_t ControlServer::watchers() const {
  return static_cast<std::size_t>(
      std::ranges::count_if(sessions_, [](const auto& session) { return session->is_watching(); }));
}

void ControlServer::report_whether_watched() {
  const bool is_watched = has_watchers();
  if (std::exchange(was_watched_, is_watched) != is_watched) handler_.on_watched(is_watched);
}

void ControlServer::publish(const TraceEvent& event) {
  std::string line;
  for (const auto& session : sessions_) {
    if (!session->wants(event)) continue;
    if (line.empty()) line = control::event_line(event);
    session->offer_event(line, event.at);
  }
}

Counters ControlServer::counters() const {
  return {{"clients", counts_.clients},
          {"clients_refused", counts_.clients_refused},
          {"watchers_dropped", counts_.watchers_dropped},
          {"events_lost", counts_.events_lost},
          {"bad_requests", counts_.bad_requests},
          {"requests_dropped", counts_.requests_dropped}};
}

void ControlServer::accept() {
  acceptor_.async_accept([this, alive = std::weak_ptr(alive_)](error_code error, Socket socket) {
    if (!alive.expired()) on_accept(error, std::move(socket));
  });
}

void ControlServer::on_accept(error_code error, Socket socket) {
  if (!error) {
    admit(std::move(socket));
    return accept();
  }
  // Most likely no file descriptor is free. Without a pause, the waiting client makes this spin.
  retry_timer_.after(accept_retry, [this] { accept(); });
}

void ControlServer::admit(Socket socket) {
  if (sessions_.size() >= limits_.clients) {
    ++counts_.clients_refused;
    error_code ignored;  // a few bytes into an empty buffer: never blocks, and may be lost
    socket.non_blocking(true, ignored);
    asio::write(socket,
                asio::buffer(control::error_line(std::to_string(limits_.clients) +
                                                 " clients are connected, which is the limit: "
                                                 "end some slam-gatewayctl commands first")),
                ignored);
    return;
  }
  ++counts_.clients;
  sessions_.push_back(std::make_shared<Session>(std::move(socket), *this));
  sessions_.back()->read_line();
}

void ControlServer::remove(const Session& ended) {
  std::erase_if(sessions_, [&ended](const auto& each) { return each.get() == &ended; });
  report_whether_watched();
}

}  // namespace slamgw
