// SPDX-License-Identifier: Apache-2.0
// The commands of `slam-gatewayctl send`: each goes to the core like one from the broker, and its
// sender waits here for the outcome of exactly that command.
#pragma once

#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "daemon/core/messages.hpp"

namespace slamgw {

class OperatorCommands {
 public:
  /// Called once, with `{"outcome", "after_ms", "why"}`.
  using Done = std::function<void(nlohmann::json)>;
  /// Gives the command to the core. The core's actions are performed only after this returns.
  using Submit =
      std::function<CommandId(const std::string& robot, const std::string& type, Bytes payload)>;
  static constexpr std::size_t max_waiting = 64;

  /// Calls `done` at once when the command can't be sent, else when it has ended, which the core
  /// guarantees within 30 s. Returns why the command can't be sent; empty when it can.
  std::string send(const std::string& robot, const std::string& type, Bytes payload,
                   const Submit& submit, Done done);
  /// Takes the outcome of any command.
  void on_outcome(const CommandOutcome& outcome);
  /// The robot's next gateway publishes the outcome of this command.
  void on_handed_on(CommandId command);

 private:
  std::map<CommandId, Done> waiting_;
};

}  // namespace slamgw
