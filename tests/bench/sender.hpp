// SPDX-License-Identifier: Apache-2.0
// A way for the clients' messages to reach the broker: through the daemon (Swarm) or straight
// (RawSender). The same load drives both.
#pragma once

#include <optional>

#include "tests/bench/message.hpp"
#include "tests/bench/poller.hpp"

namespace slamgw::bench {

class Sender {
 public:
  virtual ~Sender() = default;
  /// The next client, in turn, that has nothing unacknowledged.
  virtual std::optional<std::size_t> free_client() = 0;
  /// Sends at once, or as soon as what is before it has been acknowledged. `qos` is 0 or 1.
  virtual void submit(const Message& message, unsigned qos) = 0;
  /// What is unacknowledged or waits for its turn.
  virtual std::size_t unfinished() const = 0;
  virtual void on_readable(std::uint64_t token) = 0;
  /// Now and then: repeats what has not been answered.
  virtual void on_tick(Clock::time_point now) = 0;
  /// After a number of submits.
  virtual void flush() = 0;
  virtual std::uint64_t repeats() const = 0;
};

}  // namespace slamgw::bench
