// SPDX-License-Identifier: Apache-2.0
// The daemon's control socket as slam-gatewayctl sees it: blocking lines of JSON, and failures in
// words that say what to do.
#pragma once

#include <chrono>
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <stdexcept>
#include <string>

namespace slamgw::ctl {

/// How long the daemon may take for an answer that it has at once.
inline constexpr std::chrono::seconds answer_patience{10};

/// Ends the program with status 1 and this text.
struct Failure : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// The daemon said nothing for too long.
struct Silence : Failure {
  using Failure::Failure;
};

/// No daemon listens at the socket.
struct NotRunning : Failure {
  using Failure::Failure;
};

class Connection {
 public:
  /// Throws Failure, and NotRunning when there is no daemon.
  explicit Connection(std::string path);
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Sends a request and gives its `result`. An `error`, silence for so long, and anything that is
  /// not the daemon's language are Failures.
  /// Calls `on_waiting` several times a second with the time that has passed. When it throws, the
  /// request is over.
  using OnWaiting = std::function<void(std::chrono::milliseconds)>;
  nlohmann::json ask(const nlohmann::json& request, std::chrono::seconds patience = answer_patience,
                     const OnWaiting& on_waiting = {});
  /// The next event of a watch, however long it takes. A Failure when the daemon hangs up.
  nlohmann::json next_event();
  /// The same; nothing when none comes in time.
  std::optional<nlohmann::json> next_event_within(std::chrono::seconds patience);

 private:
  void send(const std::string& text);
  nlohmann::json receive();
  nlohmann::json result_in(nlohmann::json answer) const;

  std::string path_;
  int socket_ = -1;
  std::string input_;
};

}  // namespace slamgw::ctl
