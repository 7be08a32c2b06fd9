// SPDX-License-Identifier: Apache-2.0
// The way down: gives each command to the mesh that reaches its robot, or refuses it, and publishes
// its one outcome (docs/topics.md, promise 6). Pure; part of Gateway.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "daemon/core/command_ledger.hpp"
#include "daemon/core/gateway_actions.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/robot_directory.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

class Commands {
 public:
  struct Counts {
    std::uint64_t down = 0;           ///< broker messages that were given to a mesh or refused
    std::uint64_t late_outcomes = 0;  ///< of commands that had ended already
  };

  /// All three outlive it.
  Commands(const TopicScheme& scheme, RobotDirectory& directory, GatewayActions& actions,
           std::size_t max_open);

  /// From the robot's session: nobody else has this message. Its `command` is given here.
  void on_robot_message(RobotMessage message, const Now& now);
  /// A command that an operator (`who`, see AuditFacts) sends. The id comes back in a
  /// CommandOutcome.
  CommandId on_operator_command(const std::string& who, const std::string& robot,
                                const std::string& type, Bytes payload, const Now& now);
  /// A command that waited at the broker for too long while no gateway held the robot's session, or
  /// whose robot `has_begun_anew`.
  void on_stale_command(const std::string& robot, BrokerMessage message, bool has_begun_anew);
  /// A command that the gateway hears for all names: `message` is in a command's topic. One for a
  /// robot with a session is left to it; one for a name that nobody has is refused after a moment.
  void on_stray_command(BrokerMessage message, const Now& now);
  /// A mesh tells it.
  void on_outcome(CommandOutcome outcome, const Now& now);
  /// The command goes to the robot's next gateway, which tells its outcome.
  void on_handed_on(CommandId command);
  /// `settled_at`: from then on other gateways' robots are known, so a name that nobody has is
  /// unknown. Nothing while the broker is away.
  void on_broker_link(std::optional<TimePoint> settled_at) { settled_at_ = settled_at; }
  /// The robot's session is new, so what came before it is here.
  void on_session_begun(const std::string& robot, const Now& now);
  /// The gateway hears commands for all names no longer.
  void forget_strays() { strays_.clear(); }
  void on_stop(const Now& now);

  std::size_t open() const { return ledger_.size(); }
  const Counts& counts() const { return counts_; }

  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

 private:
  CommandId deliver(RobotMessage message, const Now& now);
  void refuse(const Command& command, const Now& now);
  void refuse_strays(const Now& now);
  void refuse_stray(const StrayCommands::Stray& stray, const Now& now);
  void refuse_unknown(CommandOutcome outcome, const Now& now, const Sender& sender);
  void conclude(CommandOutcome outcome, const Sender& sender);
  void report(Notice notice, const std::string& type, std::string_view outcome,
              const Sender& sender);
  void publish(CommandOutcome outcome);

  const TopicScheme& scheme_;
  RobotDirectory& directory_;
  GatewayActions& actions_;
  CommandLedger ledger_;
  StrayCommands strays_;
  std::optional<TimePoint> settled_at_;
  LogThrottle unknown_throttle_;
  Counts counts_;
};

}  // namespace slamgw
