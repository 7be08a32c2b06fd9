// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/command_watch.hpp"

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

std::shared_ptr<Command> CommandWatch::begin(const ClientSession& session, const std::string& topic,
                                             CommandId id, TimePoint now) {
  const auto parsed = context_.policy.scheme().parse_command_topic(topic);
  if (!parsed || parsed->robot != session.robot) return nullptr;
  auto command = std::make_shared<Command>(
      Command{id, std::string(parsed->robot), std::string(parsed->type), now, false});
  make_room(now);
  open_.push_back(command);
  return command;
}

void CommandWatch::adopt(const std::shared_ptr<Command>& command, TimePoint now) {
  make_room(now);
  const auto place = std::ranges::upper_bound(open_, command->came, {},
                                              [](const auto& other) { return other->came; });
  open_.insert(place, command);
}

/// The oldest is not watched to its end when there are too many.
void CommandWatch::make_room(TimePoint now) {
  while (!open_.empty() && open_.front()->is_reported) open_.pop_front();
  if (open_.size() < limits::max_tracked_commands) return;
  end(open_.front(), CommandResult::timeout, "too many commands are waiting", now);
  open_.pop_front();
}

void CommandWatch::end(const std::shared_ptr<Command>& command, CommandResult result,
                       std::string why, TimePoint now) {
  if (!command || std::exchange(command->is_reported, true)) return;
  // After a restart it is not told again; a delivery has marked its session already.
  if (const ClientSession* session = context_.clients.find_robot(command->robot);
      session && result != CommandResult::delivered)
    context_.set_dirty(*session);
  const auto after = std::chrono::duration_cast<std::chrono::milliseconds>(now - command->came);
  context_.emit(CommandOutcome{Mesh::thread, command->id, command->robot, command->type, result,
                               after, std::move(why)});
}

std::optional<TimePoint> CommandWatch::deadline() const {
  if (open_.empty()) return std::nullopt;
  return open_.front()->came + limits::command_patience;
}

void CommandWatch::on_deadline(TimePoint now) {
  while (!open_.empty() && open_.front()->came + limits::command_patience <= now) {
    const std::shared_ptr<Command> command = std::move(open_.front());
    open_.pop_front();
    const ClientSession* session = context_.clients.find_robot(command->robot);
    const bool sleeps = session && session->state == ClientState::asleep;
    end(command, CommandResult::timeout,
        sleeps ? "the robot sleeps; it gets the command when it wakes" : "no acknowledgement", now);
  }
}

}  // namespace slamgw::mqttsn
