// SPDX-License-Identifier: Apache-2.0
#include "daemon/control/control_server.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/error.hpp>
#include <boost/asio/write.hpp>
#include <filesystem>
#include <stdexcept>
#include <system_error>
#include <utility>

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

}  // namespace

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
  return {{"clients", counters_.clients},
          {"clients_refused", counters_.clients_refused},
          {"watchers_dropped", counters_.watchers_dropped},
          {"events_lost", counters_.events_lost},
          {"bad_requests", counters_.bad_requests},
          {"requests_dropped", counters_.requests_dropped}};
}

void ControlServer::accept() {
  acceptor_.async_accept(
      [this, alive = std::weak_ptr(alive_)](error_code error, ControlSession::Socket socket) {
        if (!alive.expired()) on_accept(error, std::move(socket));
      });
}

void ControlServer::on_accept(error_code error, ControlSession::Socket socket) {
  if (!error) {
    admit(std::move(socket));
    return accept();
  }
  // Most likely no file descriptor is free. Without a pause, the waiting client makes this spin.
  retry_timer_.after(accept_retry, [this] { accept(); });
}

void ControlServer::admit(ControlSession::Socket socket) {
  if (sessions_.size() >= limits_.clients) {
    ++counters_.clients_refused;
    error_code ignored;  // a few bytes into an empty buffer: never blocks, and may be lost
    socket.non_blocking(true, ignored);
    asio::write(socket,
                asio::buffer(control::error_line(std::to_string(limits_.clients) +
                                                 " clients are connected, which is the limit: "
                                                 "end some slam-gatewayctl commands first")),
                ignored);
    return;
  }
  ++counters_.clients;
  auto session = std::make_shared<ControlSession>(
      std::move(socket), limits_, counters_, handler_,
      [this] { return watchers() < limits_.watchers; }, [this] { report_whether_watched(); },
      [this](ControlSession& ended) {
        std::erase_if(sessions_, [&ended](const auto& each) { return each.get() == &ended; });
        report_whether_watched();
      });
  sessions_.push_back(session);
  session->start();
}

}  // namespace slamgw
