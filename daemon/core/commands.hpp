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
    std::uint64_t down = 0;            ///< broker messages that were given to a mesh or refused
    PerMesh<std::uint64_t> down_on{};  ///< those of a robot that a mesh reaches, by mesh
    std::uint64_t late_outcomes = 0;   ///< outcomes of commands that had already ended
  };

  /// The three references must outlive this object.
  Commands(const TopicScheme& scheme, RobotDirectory& directory, GatewayActions& actions,
           std::size_t max_open);

  /// Takes a message from the robot's own session, which no other gateway has. Gives it its command
  /// id.
  void on_robot_message(RobotMessage message, const Now& now);
  /// Sends a command of an operator. Robot and type must be one topic level each.
  CommandId on_operator_command(Asker asker, const std::string& robot, const std::string& type,
                                Bytes payload, const Now& now);
  /// Refuses a command that waited at the broker: for too long while no gateway held the robot's
  /// session, or, if `has_begun_anew`, until the robot began a clean session.
  void on_stale_command(const std::string& robot, BrokerMessage message, bool has_begun_anew);
  /// Takes a command from the subscription for all names; `message` has a command's topic. Leaves
  /// it to the robot's session if there is one. Refuses it after a moment if no robot has this
  /// name.
  void on_stray_command(BrokerMessage message, const Now& now);
  /// Takes the outcome that a mesh reports.
  void on_outcome(CommandOutcome outcome, const Now& now);
  /// Ends a command without an outcome here: the robot's next gateway carries it and publishes its
  /// outcome.
  void on_handed_on(CommandId command);
  /// `settled_at`: when other gateways' robots are known, so that a name without a robot can be
  /// refused; nothing while the broker is offline.
  void on_broker_link(std::optional<TimePoint> settled_at);
  /// The stray commands for this robot wait no longer. A session that `was_present` brings them;
  /// for a new session they are delivered here if the robot has subscribed to them.
  void on_session_held(const std::string& robot, bool was_present, const Now& now);
  /// Drops the stray commands for this robot: its session brought them, and they were refused.
  void on_session_sorted(const std::string& robot) { strays_.take_all(robot); }
  /// Drops all stray commands. Call when the gateway stops hearing commands for all names.
  void forget_strays() { strays_.take_all(); }
  /// Refuses the stray commands that still wait, except for this gateway's robots: after a restart
  /// their sessions may bring them.
  void on_stop(const Now& now);

  std::size_t open() const { return ledger_.size(); }
  const Counts& counts() const { return counts_; }

  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

 private:
  CommandId deliver(RobotMessage message, const Now& now);
  void refuse(const Command& command, const Now& now);
  void hold(StrayCommands::Stray stray);
  void refuse_strays(const Now& now);
  bool awaits_session(const std::string& robot) const;
  void refuse_unserved(const StrayCommands::Stray& stray, const Now& now);
  void refuse_stray(const StrayCommands::Stray& stray, std::string why, const Now& now);
  void refuse_unknown(CommandOutcome outcome, const Now& now, const Sender& sender);
  void conclude(CommandOutcome outcome, const Sender& sender);
  void report(Notice notice, const std::string& type, std::string_view outcome,
              const Sender& sender);
  void publish(CommandOutcome outcome, const Sender& sender);
  void answer(const Sender& sender, const CommandOutcome& outcome);

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
