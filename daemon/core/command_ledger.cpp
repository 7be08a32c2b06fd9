// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/command_ledger.hpp"

#include <utility>

namespace slamgw {

bool CommandLedger::open(Command command, TimePoint now) {
  if (open_.size() >= max_open_) return false;
  const CommandId id = command.id;
  const TimePoint came = now - command.waited;
  return open_.insert({id, came, std::move(command)}).second;
}

bool CommandLedger::end(CommandId id) { return open_.erase(id) > 0; }

std::optional<TimePoint> CommandLedger::deadline() const {
  if (open_.empty()) return std::nullopt;
  return by_age().begin()->came + patience;
}

std::vector<Command> CommandLedger::take_overdue(TimePoint now) {
  std::vector<Command> overdue;
  while (!open_.empty() && by_age().begin()->came + patience <= now) {
    overdue.push_back(by_age().begin()->command);
    by_age().erase(by_age().begin());
  }
  return overdue;
}

}  // namespace slamgw
