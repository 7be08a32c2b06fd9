// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/downlink.hpp"

#include <fmt/format.h>

namespace slamgw::ble {

void Downlink::on_command(Robot& robot, std::string_view type, const BrokerMessage& message,
                          CommandId id, TimePoint now) {
  if (message.retain && !may_take_retained(robot, message, now)) return;
  const auto refuse = [&](std::string why) {
    conclude(robot, {{{Mesh::ble, id, robot.id, std::string(type), CommandResult::refused,
                       message.waited, std::move(why)},
                      {}}});
  };
  if (is_stopping_) return refuse(gateway_ends);
  if (!link_.is_up && !link_.is_starting)
    return refuse("the BLE link is down (slam-gatewayctl status says why)");
  auto command =
      make_command(settings_, type, message.payload, ++last_tid_, radio_.max_send_bytes());
  if (!command.has_value()) return refuse(command.error().why);
  command->id = id;
  command->message = message;
  conclude(robot, robot.commands.add(std::move(*command), now));
  transmit_due(robot, now);
}

bool Downlink::may_take_retained(Robot& robot, const BrokerMessage& message, TimePoint now) {
  if (robot.is_online && !link_.is_up) robot.misses_retained = true;
  if (!robot.is_online || !may_send_to(robot)) return false;
  if (robot.retained_given.contains(message.topic)) return false;
  if (robot.retained_given.size() < max_retained)
    return robot.retained_given.insert(message.topic).second;
  ++retained_dropped_;
  if (const auto count = retained_throttle_.on_event(now))
    warn(fmt::format("{}: {} retained command(s) dropped, the last on {}: a BLE robot gets "
                     "at most {} each time it comes online",
                     robot.id, *count, message.topic, max_retained),
         robot.id);
  return false;
}

bool Downlink::on_status(Robot& robot, Opcode status, TimePoint now) {
  EndedCommands ended = robot.commands.on_status(status, now);
  const bool is_answer = !ended.empty();
  conclude(robot, std::move(ended));
  transmit_due(robot, now);
  return is_answer;
}

void Downlink::on_deadline(Robot& robot, TimePoint now) {
  conclude(robot, robot.commands.on_deadline(now));
  transmit_due(robot, now);
}

void Downlink::end_all(Robot& robot, const std::string& why, TimePoint now) {
  conclude(robot, robot.commands.end_all(why, now));
}

std::vector<WaitingMessage> Downlink::give_up(Robot& robot, TimePoint now) {
  conclude(robot, robot.commands.end_sent("the robot moved to another gateway", now));
  return robot.commands.take_waiting(now);
}

/// While the gate is closed, nothing is sent: another gateway may command the robot, and a repeat
/// from here must not overtake that command.
bool Downlink::may_send_to(const Robot& robot) const {
  return link_.is_up && gate_.is_open_for(robot);
}

std::optional<TimePoint> Downlink::deadline(const Robot& robot) const {
  if (robot.commands.size() == 0) return std::nullopt;
  return robot.commands.deadline(may_send_to(robot));
}

void Downlink::transmit_due(Robot& robot, TimePoint now) {
  if (robot.commands.size() == 0 || !may_send_to(robot)) return;
  const auto next = robot.commands.next_transmission(now);
  if (!next) return;
  if (is_traced_) {
    emit(MessageStep{.kind = StepKind::sent,
                     .mesh = Mesh::ble,
                     .robot = robot.id,
                     .topic = topics_.command_topic(robot.id, next->command.type),
                     .wire = {std::nullopt, next->is_repeat},
                     .command = next->command.id});
  }
  // The queue repeats a message that the radio does not take.
  radio_.send({robot.address, robot.key, next->command.access}, now);
}

void Downlink::conclude(const Robot& robot, EndedCommands ended) {
  for (EndedCommand& command : ended) {
    ++ended_[static_cast<std::size_t>(command.result)];
    if (!command.access.empty()) radio_.withdraw(robot.address, command.access);
    command.robot = robot.id;
    if (robot.is_deaf && command.result == CommandResult::timeout)
      command.why += "; it does not hear the gateway";
    emit(static_cast<CommandOutcome&&>(command));
  }
}

}  // namespace slamgw::ble
