// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/messages.hpp"

namespace slamgw {

std::string_view to_string(Presence presence) {
  switch (presence) {
    case Presence::online: return "online";
    case Presence::asleep: return "asleep";
    case Presence::offline: return "offline";
  }
  return "offline";
}

std::string_view to_string(CommandResult result) {
  switch (result) {
    case CommandResult::delivered: return "delivered";
    case CommandResult::sent: return "sent";
    case CommandResult::timeout: return "timeout";
    case CommandResult::refused: return "refused";
    case CommandResult::superseded: return "superseded";
  }
  return "refused";
}

std::string_view to_string(StepKind kind) {
  switch (kind) {
    case StepKind::arrived: return "arrived";
    case StepKind::repeat: return "repeat";
    case StepKind::stored: return "stored";
    case StepKind::published: return "published";
    case StepKind::acknowledged: return "acknowledged";
    case StepKind::refused: return "refused";
    case StepKind::command: return "command";
    case StepKind::sent: return "sent";
    case StepKind::outcome: return "outcome";
  }
  return {};
}

Severity severity_of(CommandResult result) {
  switch (result) {
    case CommandResult::delivered:
    case CommandResult::sent:
    case CommandResult::superseded: return Severity::info;
    case CommandResult::timeout:
    case CommandResult::refused: break;
  }
  return Severity::warning;
}

}  // namespace slamgw
