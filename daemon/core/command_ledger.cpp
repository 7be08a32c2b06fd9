// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/command_ledger.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {

bool CommandLedger::open(Command command, TimePoint now) {
  if (open_.size() >= max_open_) return false;
  const CommandId id = command.id;
  const TimePoint came = now - command.waited;
  return open_.insert({id, came, std::move(command)}).second;
}

std::optional<Command> CommandLedger::end(CommandId id) {
  const auto found = open_.find(id);
  if (found == open_.end()) return std::nullopt;
  Command ended = found->command;
  open_.erase(found);
  return ended;
}

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

void StrayCommands::add(Stray stray, TimePoint due) {
  octets_ += stray.message.payload.size();
  waiting_.emplace(due, std::move(stray));
}

std::optional<StrayCommands::Stray> StrayCommands::take_due(TimePoint now) {
  if (waiting_.empty() || (!is_full() && waiting_.begin()->first > now)) return std::nullopt;
  Stray taken = std::move(waiting_.begin()->second);
  waiting_.erase(waiting_.begin());
  octets_ -= taken.message.payload.size();
  return taken;
}

std::vector<StrayCommands::Stray> StrayCommands::take_all(std::string_view of) {
  std::vector<Stray> taken;
  for (auto each = waiting_.begin(); each != waiting_.end();) {
    const auto stray = each++;
    if (!of.empty() && stray->second.robot != of) continue;
    octets_ -= stray->second.message.payload.size();
    taken.push_back(std::move(stray->second));
    waiting_.erase(stray);
  }
  std::ranges::stable_sort(taken, {}, &Stray::came);
  return taken;
}

std::optional<TimePoint> StrayCommands::deadline() const {
  if (waiting_.empty()) return std::nullopt;
  return waiting_.begin()->first;
}

}  // namespace slamgw
