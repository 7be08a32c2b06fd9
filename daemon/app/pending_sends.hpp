// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl send` waits here for the outcome of its command.
#pragma once

#include <deque>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

class PendingSends {
 public:
  using Done = std::function<void(nlohmann::json)>;
  static constexpr std::size_t max_waiting = 64;
  /// A little more than what a mesh may take (contract, promise 6).
  static constexpr std::chrono::seconds patience{35};

  bool is_full() const { return waiting_.size() >= max_waiting; }
  /// Not when it is full.
  void add(CommandId command, Done done, TimePoint now);
  /// Answers the caller that waits for this command.
  void on_outcome(const CommandOutcome& outcome);
  /// Gives up on those that nobody answered. To be called now and then.
  void on_time(TimePoint now);

 private:
  struct Waiting {
    CommandId command;
    Done done;
    TimePoint since;
  };
  std::deque<Waiting> waiting_;
};

nlohmann::json outcome_json(std::string_view outcome, std::int64_t after_ms,
                            const std::string& why);

}  // namespace slamgw
