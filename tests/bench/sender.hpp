// SPDX-License-Identifier: Apache-2.0
// The path of the clients' messages to the broker: through the daemon (Swarm) or direct
// (RawSender). The same load drives both.
#pragma once

#include <optional>

#include "tests/bench/message.hpp"
#include "tests/bench/poller.hpp"

namespace slamgw::bench {

class Sender {
 public:
  virtual ~Sender() = default;
  /// Returns the next client, in turn, without an unacknowledged message.
  virtual std::optional<std::size_t> free_client() = 0;
  /// Sends at once, or once the messages before it are acknowledged. `qos` is 0 or 1.
  virtual void submit(const Message& message, unsigned qos) = 0;
  /// Returns how many messages are unacknowledged or wait for their turn.
  virtual std::size_t unfinished() const = 0;
  virtual void on_readable(std::uint64_t token) = 0;
  /// Repeats unanswered messages. Call it regularly.
  virtual void on_tick(Clock::time_point now) = 0;
  /// Call it after a number of submits.
  virtual void flush() = 0;
  virtual std::uint64_t repeats() const = 0;
};

}  // namespace slamgw::bench
