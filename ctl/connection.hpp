// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl's side of the control socket: blocking, with lines of JSON. Failures name the
// remedy in words.
#pragma once

#include <chrono>
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <stdexcept>
#include <string>

namespace slamgw::ctl {

/// Time that the daemon may take for an answer that it has at once.
inline constexpr std::chrono::seconds answer_patience{10};

/// Ends the program with status 1 and this text.
struct Failure : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// The daemon did not answer in time.
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

  /// Called several times a second with the time that has passed. When it throws, the request ends.
  using OnWaiting = std::function<void(std::chrono::milliseconds)>;
  /// Sends a request and returns its `result`. Throws Failure for an `error`, for silence beyond
  /// `patience`, and for an answer that does not come from a daemon.
  nlohmann::json ask(const nlohmann::json& request, std::chrono::seconds patience = answer_patience,
                     const OnWaiting& on_waiting = {});
  /// Waits for the next event of a watch without a limit. Throws Failure when the daemon hangs up.
  nlohmann::json next_event();
  /// As next_event(), but returns nothing when no event comes in time.
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
