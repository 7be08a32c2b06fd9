// SPDX-License-Identifier: Apache-2.0
// Tells the outcome of each command exactly once: when the robot has it, when it can't get it, or
// when 30 s are over. Knows nothing of the delivery, which the gateway withdraws then.
#pragma once

#include <deque>
#include <memory>

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/name_rules.hpp"
#include "adapters/mqttsn_udp/output.hpp"

namespace slamgw::mqttsn {

class CommandWatch {
 public:
  CommandWatch(const NameRules& rules, ClientTable& clients, Output& output)
      : rules_(rules), clients_(clients), output_(output) {}

  /// A command that no client can carry out. Nothing happens when `id` is none.
  void refuse(const BrokerMessage& message, CommandId id, std::string why);
  /// Null when `message` is no command for this client's robot, or when it is refused at once
  /// because too many are open.
  std::shared_ptr<Command> begin(const ClientSession& session, const BrokerMessage& message,
                                 CommandId id, TimePoint now);
  /// From before a restart of the daemon: its outcome is still owed.
  void adopt(const std::shared_ptr<Command>& command);
  /// `command` may be null.
  void end(const std::shared_ptr<Command>& command, CommandResult result, std::string why,
           TimePoint now);

  std::optional<TimePoint> deadline() const;
  /// A command whose time is over; `end()` reports its outcome. Null when there is none.
  std::shared_ptr<Command> pop_overdue(TimePoint now);

 private:
  const NameRules& rules_;
  ClientTable& clients_;
  Output& output_;
  std::deque<std::shared_ptr<Command>> open_;  // in the order they came, so in that of their ends
};

}  // namespace slamgw::mqttsn
