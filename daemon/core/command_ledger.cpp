// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/command_ledger.hpp"

#include <utility>

namespace slamgw {

bool CommandLedger::open(Command command, TimePoint now) {
  if (open_.size() >= max_open_) return false;
  const CommandId id = command.id;
  open_.emplace_hint(open_.end(), id, Entry{std::move(command), now});
  return true;
}

std::optional<TimePoint> CommandLedger::deadline() const {
  if (open_.empty()) return std::nullopt;
  return open_.begin()->second.since + patience;
}

std::vector<Command> CommandLedger::take_overdue(TimePoint now) {
  std::vector<Command> overdue;
  while (!open_.empty() && open_.begin()->second.since + patience <= now) {
    overdue.push_back(std::move(open_.begin()->second.command));
    open_.erase(open_.begin());
  }
  return overdue;
}

}  // namespace slamgw
