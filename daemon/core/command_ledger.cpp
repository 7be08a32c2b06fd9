// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/command_ledger.hpp"

#include <algorithm>
#include <iterator>
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

void StrayCommands::add(BrokerMessage message, std::string_view robot, TimePoint now) {
  octets_ += message.payload.size();
  const TimePoint came = now - message.waited;
  waiting_.push_back({std::move(message), std::string(robot), came});
}

std::vector<StrayCommands::Stray> StrayCommands::take_overdue(TimePoint now) {
  std::vector<Stray> overdue;
  while (!waiting_.empty()) {
    const bool is_over_bound = waiting_.size() > max_waiting || octets_ > max_octets;
    if (!is_over_bound && now - waiting_.front().came < wait_) break;
    octets_ -= waiting_.front().message.payload.size();
    overdue.push_back(std::move(waiting_.front()));
    waiting_.pop_front();
  }
  return overdue;
}

std::vector<StrayCommands::Stray> StrayCommands::take_for(std::string_view robot) {
  const auto first = std::stable_partition(waiting_.begin(), waiting_.end(),
                                           [&](const Stray& each) { return each.robot != robot; });
  std::vector<Stray> taken(std::make_move_iterator(first), std::make_move_iterator(waiting_.end()));
  waiting_.erase(first, waiting_.end());
  for (const Stray& each : taken) octets_ -= each.message.payload.size();
  return taken;
}

std::optional<TimePoint> StrayCommands::deadline() const {
  if (waiting_.empty()) return std::nullopt;
  return waiting_.front().came + wait_;
}

}  // namespace slamgw
