// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/core/announcements.hpp"
#include "daemon/core/rights_probe.hpp"

namespace slamgw {

Commands::Commands(const TopicScheme& scheme, RobotDirectory& directory, GatewayActions& actions,
                   std::size_t max_open)
    : scheme_(scheme), directory_(directory), actions_(actions), ledger_(max_open) {}

void Commands::on_robot_message(RobotMessage message, const Now& now) {
  const auto target = scheme_.parse_command_topic(message.message.topic);
  if (target && RightsProbe::is_of_any_gateway(target->type, message.message)) return;
  if (target && target->robot == message.robot) {
    deliver(std::move(message), now);
    return;
  }
  ++counts_.down;
  if (const Robot* known = directory_.registry.find(message.robot))
    ++counts_.down_on[known->mesh()];
  actions_.push(DeliverToMesh{std::nullopt, std::move(message)});
}

CommandId Commands::on_operator_command(Asker asker, const std::string& robot,
                                        const std::string& type, Bytes payload, const Now& now) {
  auto sender = std::make_shared<const Asker>(std::move(asker));
  BrokerMessage message{scheme_.command_topic(robot, type), std::move(payload), Qos::at_least_once};
  const bool is_elsewhere =
      directory_.places.is_elsewhere(robot) && !directory_.places.is_held(robot);
  if (is_elsewhere || !directory_.places.may_want(robot, message.topic)) {
    const CommandId id = ledger_.next_id();
    conclude({std::nullopt,
              id,
              robot,
              type,
              CommandResult::refused,
              {},
              is_elsewhere ? "another gateway serves this robot"
                           : "the robot has not subscribed to " + message.topic},
             sender);
    return id;
  }
  message.sender = std::move(sender);
  return deliver({robot, std::move(message)}, now);
}

void Commands::on_stale_command(const std::string& robot, BrokerMessage message,
                                bool has_begun_anew) {
  const auto target = scheme_.parse_command_topic(message.topic);
  if (!target || target->robot != robot) return;
  ++counts_.down;
  conclude({std::nullopt, ledger_.next_id(), robot, std::string(target->type),
            CommandResult::refused, message.waited,
            has_begun_anew ? "waited at the broker until the robot began a clean session"
                           : "waited too long at the broker while no gateway served the robot"},
           message.sender);
}

/// Refuses a banned robot's command at once, because such a robot never gets a session.
void Commands::on_stray_command(BrokerMessage message, const Now& now) {
  const std::string robot(scheme_.parse_command_topic(message.topic)->robot);
  if (directory_.places.is_shown(robot)) return;  // the robot's session brings the command
  if (directory_.names.is_banned(robot)) {
    deliver({robot, std::move(message)}, now);
    return;
  }
  if (directory_.registry.find(robot)) actions_.push(WantSession{robot});
  const TimePoint came = now.mono - message.waited;
  hold({std::move(message), robot, came});
  refuse_strays(now);
}

void Commands::on_broker_link(std::optional<TimePoint> settled_at) {
  settled_at_ = settled_at;
  for (StrayCommands::Stray& stray : strays_.take_all()) hold(std::move(stray));
}

/// Until the other gateways' robots are known, a command waits for StrayCommands::longest.
void Commands::hold(StrayCommands::Stray stray) {
  TimePoint due = stray.came + StrayCommands::longest;
  if (settled_at_ && !stray.awaits_session)
    due = std::min(due, std::max(stray.came + StrayCommands::patience, *settled_at_));
  strays_.add(std::move(stray), due);
}

void Commands::on_outcome(CommandOutcome outcome, const Now& now) {
  // A command without an id came before a restart.
  const auto command = ledger_.end(outcome.id);
  if (!command && outcome.id != CommandId::none) {
    ++counts_.late_outcomes;
    return;
  }
  if (directory_.names.is_on_both(outcome.robot)) directory_.choice.on_outcome(outcome, now.mono);
  conclude(std::move(outcome), command ? command->sender : nullptr);
}

void Commands::on_handed_on(CommandId command) {
  const auto ended = ledger_.end(command);
  if (!ended) return;
  if (is_operator(who_of(ended->sender)))  // the next gateway does not know who asked
    report(
        {Severity::notice,
         fmt::format("- {} {} is handed on to the robot's next gateway", ended->robot, ended->type),
         ended->robot, Occasion::command_outcome},
        ended->type, "handed on", ended->sender);
  answer(ended->sender, {ended->carrier,
                         command,
                         ended->robot,
                         ended->type,
                         CommandResult::timeout,
                         {},
                         "the robot moved to another gateway, which has the command now"});
}

void Commands::on_session_held(const std::string& robot, bool was_present, const Now& now) {
  for (StrayCommands::Stray& stray : strays_.take_all(robot)) {
    stray.message.waited = std::chrono::duration_cast<Waited>(now.mono - stray.came);
    if (was_present) continue;
    if (directory_.places.may_want(robot, stray.message.topic))
      deliver({robot, std::move(stray.message)}, now);
    else
      refuse_stray(stray, "the robot has not subscribed to " + stray.message.topic, now);
  }
}

void Commands::on_stop(const Now& now) {
  for (const StrayCommands::Stray& stray : strays_.take_all())
    if (!awaits_session(stray.robot)) refuse_unserved(stray, now);
}

std::optional<TimePoint> Commands::deadline() const {
  return earlier(ledger_.deadline(), strays_.deadline());
}

void Commands::on_deadline(const Now& now) {
  for (Command& command : ledger_.take_overdue(now.mono)) {
    if (command.is_retained) continue;
    conclude(
        {command.carrier, command.id, std::move(command.robot), std::move(command.type),
         CommandResult::timeout, CommandLedger::patience, "the mesh has not reported its outcome"},
        command.sender);
  }
  refuse_strays(now);
}

/// The mesh that carries a command owes its outcome. A retained command that no mesh can carry is
/// not refused: it waits at the broker.
CommandId Commands::deliver(RobotMessage message, const Now& now) {
  ++counts_.down;
  const std::string type(scheme_.parse_command_topic(message.message.topic)->type);
  const BrokerMessage& what = message.message;
  Command command{
      ledger_.next_id(), message.robot, type,       directory_.carrier_for(message.robot, now.mono),
      what.retain,       what.waited,   what.sender};
  if (command.carrier) ++counts_.down_on[*command.carrier];
  if (Robot* known = directory_.registry.find(message.robot)) {
    known->numbers.on_down(what.payload.size());
    if (command.carrier) ++known->on_mesh[*command.carrier].down;
  }
  actions_.push(TrafficEvent{.direction = Direction::down,
                             .mesh = command.carrier,
                             .robot = message.robot,
                             .type = type,
                             .topic = what.topic,
                             .payload = what.payload,
                             .qos = what.qos,
                             .update = {},
                             .wall = now.wall,
                             .at = now.mono,
                             .command = command.id});
  const bool is_banned = directory_.names.is_banned(message.robot);
  if (is_banned || !command.carrier || !ledger_.open(command, now.mono)) {
    if (!command.is_retained) refuse(command, now);
    return command.id;
  }
  message.command = command.id;
  actions_.push(DeliverToMesh{command.carrier, std::move(message)});
  return command.id;
}

void Commands::refuse(const Command& command, const Now& now) {
  CommandOutcome outcome{command.carrier,
                         command.id,
                         command.robot,
                         command.type,
                         CommandResult::refused,
                         command.waited,
                         "too many commands are on their way"};
  if (directory_.names.is_banned(command.robot)) {
    outcome.why = "the robot is banned (slam-gatewayctl unban)";
    return refuse_unknown(std::move(outcome), now, command.sender);
  }
  if (command.carrier) return conclude(std::move(outcome), command.sender);
  const bool is_known = directory_.is_known(command.robot);
  outcome.why = is_known ? "the robot is not connected" : "no robot of this name is known here";
  refuse_unknown(std::move(outcome), now, command.sender);
}

/// Refuses the stray commands that are due or beyond the bounds. A command for a robot of this
/// gateway may wait longer, because the robot's session may bring it.
void Commands::refuse_strays(const Now& now) {
  while (auto stray = strays_.take_due(now.mono)) {
    if (!std::exchange(stray->awaits_session, true) && awaits_session(stray->robot))
      hold(std::move(*stray));
    else
      refuse_unserved(*stray, now);
  }
}

/// Returns true for a robot of this gateway whose session no gateway holds: a new session will not
/// bring what came before it.
bool Commands::awaits_session(const std::string& robot) const {
  return directory_.registry.find(robot) && !directory_.places.is_shown(robot) &&
         !directory_.places.is_refused(robot);
}

/// Refuses nothing for a robot whose session some gateway holds: the session brings the command.
void Commands::refuse_unserved(const StrayCommands::Stray& stray, const Now& now) {
  const bool is_known = directory_.is_known(stray.robot);
  if (directory_.places.is_shown(stray.robot) && !directory_.places.is_refused(stray.robot)) return;
  refuse_stray(stray,
               is_known ? "the broker does not give the robot's session to this gateway"
                        : "no robot of this name is known here",
               now);
}

void Commands::refuse_stray(const StrayCommands::Stray& stray, std::string why, const Now& now) {
  const auto waited = std::chrono::duration_cast<std::chrono::milliseconds>(now.mono - stray.came);
  const std::string type(scheme_.parse_command_topic(stray.message.topic)->type);
  ++counts_.down;
  refuse_unknown({std::nullopt, ledger_.next_id(), stray.robot, type, CommandResult::refused,
                  waited, std::move(why)},
                 now, stray.message.sender);
}

void Commands::conclude(CommandOutcome outcome, const Sender& sender) {
  Notice notice{
      severity_of(outcome.result),
      fmt::format("{} {} {} {} after {} ms{}{}", outcome.mesh ? to_string(*outcome.mesh) : "-",
                  outcome.robot, outcome.type, to_string(outcome.result), outcome.after.count(),
                  outcome.why.empty() ? "" : ": ", outcome.why),
      outcome.robot, Occasion::command_outcome, outcome.after};
  notice.mesh = outcome.mesh;
  report(std::move(notice), outcome.type, to_string(outcome.result), sender);
  publish(std::move(outcome), sender);
}

/// Writes a line of the audit trail about a command. An operator's command is at least a notice.
void Commands::report(Notice notice, const std::string& type, std::string_view outcome,
                      const Sender& sender) {
  notice.audit = AuditFacts{who_of(sender), "command " + type, std::string(outcome)};
  notice.type = type;
  if (sender) notice.text += "; asked by " + sender->who;
  if (is_operator(notice.audit->who)) notice.severity = std::max(notice.severity, Severity::notice);
  actions_.push(std::move(notice));
}

/// Writes one log line for a burst, because a server can invent names without end.
void Commands::refuse_unknown(CommandOutcome outcome, const Now& now, const Sender& sender) {
  const bool is_order = is_operator(who_of(sender));  // each order has its own line
  const auto count = is_order ? 1 : unknown_throttle_.on_event(now.mono);
  if (count) {
    Notice notice{
        Severity::warning,
        fmt::format(
            "- {} {} refused: {}{}", outcome.robot, outcome.type, outcome.why,
            *count > 1 ? fmt::format(" ({} such commands since the last line)", *count) : ""),
        outcome.robot, Occasion::command_outcome};
    report(std::move(notice), outcome.type, to_string(outcome.result), sender);
  }
  publish(std::move(outcome), sender);
}

void Commands::publish(CommandOutcome outcome, const Sender& sender) {
  actions_.push(Upload{{scheme_.outcome_topic(outcome.robot), to_bytes(outcome_json(outcome)),
                        Qos::at_least_once, false},
                       no_receipt});
  answer(sender, outcome);
  actions_.push(std::move(outcome));
}

void Commands::answer(const Sender& sender, const CommandOutcome& outcome) {
  if (sender && sender->done) actions_.push(AnswerAsker{sender, outcome});
}

}  // namespace slamgw
