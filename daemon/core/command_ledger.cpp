// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/command_ledger.hpp"

#include <utility>

namespace slamgw {

bool CommandLedger::open(Command command, TimePoint now) {
  if (open_.size() >= max_open_) return false;
  const CommandId id = command.id;
  const TimePoint came = now - command.waited;
  open_.emplace_hint(open_.end(), id, Entry{std::move(command), came});
  by_age_.emplace_hint(by_age_.end(), came, id);
  return true;
}

bool CommandLedger::end(CommandId id) {
  const auto ended = open_.extract(id);
  if (!ended) return false;
  by_age_.erase({ended.mapped().came, id});
  return true;
}

std::optional<TimePoint> CommandLedger::deadline() const {
  if (by_age_.empty()) return std::nullopt;
  return by_age_.begin()->first + patience;
}

std::vector<Command> CommandLedger::take_overdue(TimePoint now) {
  std::vector<Command> overdue;
  while (!by_age_.empty() && by_age_.begin()->first + patience <= now) {
    const auto ended = open_.extract(by_age_.begin()->second);
    by_age_.erase(by_age_.begin());
    overdue.push_back(std::move(ended.mapped().command));
  }
  return overdue;
}

}  // namespace slamgw
