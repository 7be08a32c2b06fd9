// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/command_watch.hpp"

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void CommandWatch::refuse(const BrokerMessage& message, CommandId id, std::string why) {
  const auto parsed = rules_.policy.scheme().parse_command_topic(message.topic);
  if (!parsed || id == CommandId::none) return;
  output_.emit(CommandOutcome{Mesh::thread, id, std::string(parsed->robot),
                              std::string(parsed->type), CommandResult::refused, message.waited,
                              std::move(why)});
}

std::shared_ptr<Command> CommandWatch::begin(const ClientSession& session,
                                             const BrokerMessage& message, CommandId id,
                                             TimePoint now) {
  const auto parsed = rules_.policy.scheme().parse_command_topic(message.topic);
  if (id == CommandId::none || !parsed || parsed->robot != session.robot) return nullptr;
  auto command =
      std::make_shared<Command>(Command{id, session.client_id, std::string(parsed->robot),
                                        std::string(parsed->type), now - message.waited, false});
  adopt(command);
  return command;
}

void CommandWatch::adopt(const std::shared_ptr<Command>& command) {
  if (open_.empty() || open_.back()->came <= command->came) return open_.push_back(command);
  const auto place = std::ranges::upper_bound(open_, command->came, {},
                                              [](const auto& other) { return other->came; });
  open_.insert(place, command);
}

void CommandWatch::end(const std::shared_ptr<Command>& command, CommandResult result,
                       std::string why, TimePoint now) {
  if (!command || std::exchange(command->is_reported, true)) return;
  // After a restart it is not reported again; a delivery has marked its session already.
  if (const ClientSession* session = clients_.find(command->client_id);
      session && result != CommandResult::delivered)
    output_.mark_changed(*session);
  const auto after = std::chrono::duration_cast<std::chrono::milliseconds>(now - command->came);
  output_.emit(CommandOutcome{Mesh::thread, command->id, command->robot, command->type, result,
                              after, std::move(why)});
}

std::optional<TimePoint> CommandWatch::deadline() const {
  if (open_.empty()) return std::nullopt;
  return open_.front()->came + limits::command_patience;
}

std::shared_ptr<Command> CommandWatch::pop_overdue(TimePoint now) {
  while (!open_.empty()) {
    const bool is_overdue = open_.front()->came + limits::command_patience <= now;
    const bool is_over_bound = open_.size() > limits::max_tracked_commands;
    if (!open_.front()->is_reported && !is_overdue && !is_over_bound) return nullptr;
    const std::shared_ptr<Command> first = std::move(open_.front());
    open_.pop_front();
    if (!first->is_reported) return first;
  }
  return nullptr;
}

}  // namespace slamgw::mqttsn
