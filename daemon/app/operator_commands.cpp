// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/operator_commands.hpp"

#include <nlohmann/json.hpp>

#include <utility>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw {
namespace {

nlohmann::json outcome_json(CommandResult result, std::chrono::milliseconds after,
                            const std::string& why) {
  return {{"outcome", to_string(result)}, {"after_ms", after.count()}, {"why", why}};
}

}  // namespace

std::string OperatorCommands::send(const std::string& robot, const std::string& type, Bytes payload,
                                   const Submit& submit, Done done) {
  const auto refuse = [&](const char* why) {
    done(outcome_json(CommandResult::refused, {}, why));
    return std::string(why);
  };
  if (!is_valid_level(robot) || !is_valid_level(type))
    return refuse("robot and type must be one topic level each");
  if (waiting_.size() >= max_waiting) return refuse("too many commands wait for their outcome");
  waiting_.emplace(submit(robot, type, std::move(payload)), std::move(done));
  return {};
}

void OperatorCommands::on_outcome(const CommandOutcome& outcome) {
  if (const auto waiting = waiting_.extract(outcome.id))
    waiting.mapped()(outcome_json(outcome.result, outcome.after, outcome.why));
}

void OperatorCommands::on_handed_on(CommandId command) {
  if (const auto waiting = waiting_.extract(command))
    waiting.mapped()(outcome_json(CommandResult::timeout, {},
                                  "the robot moved to another gateway, which has the command now"));
}

}  // namespace slamgw
