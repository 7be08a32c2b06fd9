// SPDX-License-Identifier: Apache-2.0
// Tells the outcome of each command exactly once: when the robot has it, when it can't get it, or
// when it has waited for 30 s. Never touches the delivery itself.
#pragma once

#include <deque>
#include <memory>

#include "adapters/mqttsn_udp/context.hpp"

namespace slamgw::mqttsn {

class CommandWatch {
 public:
  explicit CommandWatch(Context& context) : context_(context) {}

  /// Null when `topic` is no command for this client's robot.
  std::shared_ptr<Command> begin(const ClientSession& session, const std::string& topic,
                                 CommandId id, TimePoint now);
  /// From before a restart of the daemon: its outcome is still owed.
  void adopt(const std::shared_ptr<Command>& command, TimePoint now);
  /// `command` may be null.
  void end(const std::shared_ptr<Command>& command, CommandResult result, std::string why,
           TimePoint now);

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  void make_room(TimePoint now);

  Context& context_;
  std::deque<std::shared_ptr<Command>> open_;  // in the order they came, so in that of their ends
};

}  // namespace slamgw::mqttsn
