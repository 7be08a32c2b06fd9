// SPDX-License-Identifier: Apache-2.0
#include "ctl/connection.hpp"

#include <nlohmann/json.hpp>

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "ctl/host/installation.hpp"
#include "daemon/control/wire.hpp"

namespace slamgw::ctl {
namespace {

/// Far above any answer: 10 000 robots are 3 MB.
constexpr std::size_t max_line_bytes = std::size_t{64} << 20;

constexpr const char* stranger_words =
    " does not answer like slam-gatewayd; is it the right socket?";

/// A service that has refused its configuration would refuse it again.
std::string way_to_start() {
  constexpr const char* refused = "78\n";  // EX_CONFIG
  const ProgramResult last =
      run_program({"systemctl", "show", "-P", "ExecMainStatus", service_unit});
  const std::string start = "sudo systemctl start slam-gateway";
  return last.output == refused
             ? "its configuration was refused: sudo slam-gatewayd --check-config; then: " + start
             : "start it with: " + start;
}

[[noreturn]] void fail_to_connect(const std::string& path, int error) {
  struct stat status {};
  const bool is_there = stat(path.c_str(), &status) == 0;
  if (error == ENOENT)
    throw NotRunning("slam-gatewayd is not running: there is no " + path + "; " + way_to_start());
  if (error == EACCES)
    throw Failure(
        "no permission for " + path +
        ": join the group slam-gateway (sudo adduser \"$USER\" slam-gateway), then log in "
        "again");
  if (is_there && !S_ISSOCK(status.st_mode))
    throw Failure(path + " is not a socket; pass the path of control.socket with --socket");
  if (error == ECONNREFUSED)
    throw NotRunning("slam-gatewayd is not running: no answer at " + path + "; " + way_to_start());
  throw Failure(path + ": " + std::strerror(error));
}

/// `option`: SO_RCVTIMEO, or SO_SNDTIMEO, which counts for connect() too.
void set_patience(int socket, int option, std::chrono::milliseconds patience) {
  timeval limit{};
  limit.tv_sec = patience.count() / 1000;
  limit.tv_usec = patience.count() % 1000 * 1000;
  setsockopt(socket, SOL_SOCKET, option, &limit, sizeof limit);
}

}  // namespace

Connection::Connection(std::string path) : path_(std::move(path)) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path_.size() >= sizeof address.sun_path) throw Failure(path_ + " is too long for a socket");
  std::memcpy(address.sun_path, path_.data(), path_.size());
  socket_ = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (socket_ < 0) throw Failure(std::strerror(errno));
  set_patience(socket_, SO_SNDTIMEO, answer_patience);
  if (connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) return;
  const int error = errno;
  close(socket_);
  fail_to_connect(path_, error);
}

Connection::~Connection() { close(socket_); }

nlohmann::json Connection::ask(const nlohmann::json& request, std::chrono::seconds patience,
                               const OnWaiting& on_waiting) {
  constexpr std::chrono::milliseconds interval{250};
  set_patience(socket_, SO_RCVTIMEO, interval);
  send(control::to_line(request));
  for (std::chrono::milliseconds waited{0};;) {
    try {
      return result_in(receive());
    } catch (const Silence&) {
      waited += interval;
      if (waited >= patience) throw;
      if (on_waiting) on_waiting(waited);
    }
  }
}

nlohmann::json Connection::result_in(nlohmann::json answer) const {
  if (const auto error = answer.find("error"); error != answer.end() && error->is_string())
    throw Failure(error->get<std::string>());
  if (!answer.contains("result")) throw Failure(path_ + stranger_words);
  return std::move(answer["result"]);
}

std::optional<nlohmann::json> Connection::next_event_within(std::chrono::seconds patience) try {
  set_patience(socket_, SO_RCVTIMEO, patience);
  nlohmann::json line = receive();
  if (!line.contains("event")) throw Failure(path_ + stranger_words);
  return std::move(line["event"]);
} catch (const Silence&) {
  return std::nullopt;
}

nlohmann::json Connection::next_event() {
  constexpr std::chrono::seconds for_ever{0};
  return *next_event_within(for_ever);
}

void Connection::send(const std::string& text) {
  for (std::size_t sent = 0; sent < text.size();) {
    const ssize_t count = ::send(socket_, text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return;  // the daemon hung up; receive() may still get its reason
    sent += static_cast<std::size_t>(count);
  }
}

nlohmann::json Connection::receive() {
  std::array<char, 65536> chunk{};
  std::size_t end = input_.find('\n');
  while (end == std::string::npos) {
    const ssize_t count = recv(socket_, chunk.data(), chunk.size(), 0);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
      throw Silence("slam-gatewayd does not answer at " + path_);
    if (count <= 0) throw Failure("slam-gatewayd hung up: it ended, or this client was too slow");
    const std::size_t before = input_.size();
    input_.append(chunk.data(), static_cast<std::size_t>(count));
    if (input_.size() > max_line_bytes) throw Failure(path_ + stranger_words);
    end = input_.find('\n', before);
  }
  nlohmann::json line = nlohmann::json::parse(input_.substr(0, end), nullptr, false);
  input_.erase(0, end + 1);
  if (!line.is_object()) throw Failure(path_ + stranger_words);
  return line;
}

}  // namespace slamgw::ctl
