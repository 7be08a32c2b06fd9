// SPDX-License-Identifier: Apache-2.0
// Connects the meshes with the broker: takes what they report and leaves actions. Pure; knows no
// mesh's protocol and no MQTT client. The application drains its actions.
#pragma once

#include <functional>
#include <optional>
#include <set>
#include <string>
#include <variant>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/command_ledger.hpp"
#include "daemon/core/leftover_robots.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/open_receipts.hpp"
#include "daemon/core/ownership_query.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/robot_registry.hpp"
#include "daemon/core/stray_commands.hpp"
#include "daemon/core/subscription_table.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/core/update_payload.hpp"

namespace slamgw {

/// Publish it by way of the outbox, which fires the receipt. CommandOutcome, as an action: report
/// it to the operator who has sent this command.
struct Upload {
  BrokerMessage message;
  Receipt receipt;
  /// Set for the outcome of a command: how long after the command.
  std::optional<std::chrono::milliseconds> outcome_after{};
};
/// A robot's message: show it to the observers, then publish its upload().
struct PassUp {
  TrafficEvent event;
  bool retain = false;
  /// With the topic and the payload of `event`.
  Upload upload();
};
/// Several gateways have this command; on_turn() follows when this one is to carry it out.
struct AwaitTurn {
  BrokerMessage message;
  std::string robot;
  std::string type;
};
/// The robot has fallen silent here; on_silence() follows when no other gateway hears it.
struct AskAboutRobot {
  Report will;
};
/// The core keeps nothing of the robot: it had to make room, or an operator wants it so. A session
/// in its mesh stays, and is not handed over.
struct RobotForgotten {
  std::string robot;
};
struct SubscribeAtBroker {
  std::string filter;
  Qos qos = Qos::at_most_once;
  SubscriptionId id = 0;
};
struct UnsubscribeAtBroker {
  std::string filter;
};
/// To each mesh; as a command only to its carrier.
struct DeliverToMeshes {
  BrokerMessage message;
  CommandId command = CommandId::none;
  std::optional<Mesh> carrier{};
  CommandId command_on(Mesh mesh) const { return mesh == carrier ? command : CommandId::none; }
};
struct AnswerSubscribe {
  RequiredMesh mesh;
  std::string filter;
  bool granted = false;
};

using GatewayAction = std::variant<PassUp, Upload, AwaitTurn, AskAboutRobot, RobotForgotten,
                                   SubscribeAtBroker, UnsubscribeAtBroker, DeliverToMeshes,
                                   AnswerSubscribe, CommandOutcome, TrafficEvent, MeshStep, Notice>;

/// Asks a mesh: MeshAdapter::presence_of.
using PresenceQuery = std::function<std::optional<Presence>(Mesh, const std::string& robot)>;

class Gateway {
 public:
  /// Enough to find out that a broker closes the connection at a filter, and less than the 10 s
  /// after which devices ask again (MQTT-SN 1.2 section 7.2).
  static constexpr std::chrono::seconds subscribe_patience{8};

  struct Settings {
    std::string version;
    UpdateMode update_mode = UpdateMode::positions;
    WallTime started{};  ///< "since" in `state`
    std::size_t max_open_commands = CommandLedger::default_max_open;
    bool probes_rights = false;  ///< checks the broker's access list (RightsProbe)
  };
  struct Traffic {
    std::uint64_t up = 0;             ///< robots' messages that went to the outbox
    std::uint64_t down = 0;           ///< broker messages that were given to a mesh
    std::uint64_t rejected = 0;       ///< payloads that `payload.update` could not read
    std::uint64_t late_outcomes = 0;  ///< of commands that had ended already
  };

  /// `broker` outlives it.
  Gateway(TopicScheme scheme, Settings settings, const BrokerLink& broker,
          PresenceQuery presence_on);

  void on_mesh_event(MeshEvent event, const Now& now);
  /// `subscriptions`: which of ours this copy is for, where the broker says it (MQTT 5).
  void on_broker_message(BrokerMessage message, std::span<const SubscriptionId> subscriptions,
                         const Now& now);
  /// A command that an operator sends. The id comes back in a CommandOutcome.
  CommandId on_operator_command(const std::string& robot, const std::string& type, Bytes payload,
                                const Now& now);
  /// The link to the broker came up or went down. Up: subscribes everything again and publishes
  /// `online` and every robot's presence again, because a broker without persistence has forgotten
  /// them (OwnershipQuery::may_announce). Down: subscribers that wait for the broker's answer get
  /// it when the broker is back; after `subscribe_patience` the gateway grants the subscription
  /// itself.
  void on_broker_link(const Now& now);
  /// The broker has fallen silent, or answers again (BrokerLink::is_silent). Subscribers do not
  /// wait for a silent one: what it has not granted is subscribed at the next connection.
  void on_broker_silence(const Now& now);
  void on_subscribe_result(const std::string& filter, SubscribeAnswer answer, const Now& now);
  /// A subscription of the gateway itself, to hear other gateways; renewed at each connection.
  void subscribe_own(const std::string& filter);
  /// Also ends a subscription that an earlier process made and the broker has kept.
  void unsubscribe_own(const std::string& filter);
  /// What this gateway says of itself, retained; also published when it changes, and at each
  /// connection.
  void publish_state();
  /// The receipt of a Report has fired; updates the robot's numbers.
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now);
  /// The ids in `robots` of the configuration: these robots are never evicted. A robot that has
  /// left the configuration and is offline is forgotten.
  void on_configured(std::set<std::string> robots, const Now& now);
  /// Removes a robot from the registry and its retained presence from the broker, also a robot that
  /// only an earlier process knew. Returns why that is not possible; empty when done.
  std::string forget(const std::string& robot);
  void share_with(OwnershipQuery ownership) { ownership_ = std::move(ownership); }
  /// A command of AwaitTurn is this gateway's to carry out.
  void on_turn(BrokerMessage command, const Now& now) { take_command(std::move(command), now); }
  /// No gateway hears the robot of AskAboutRobot: its will is published.
  void on_silence(Report will, const Now& now) { pass_up(std::move(will), now); }
  /// This gateway serves the robot from now on. Removes the presence that `dead_owner` left.
  void on_taken_over(const std::string& robot, const std::string& dead_owner, const Now& now);
  /// Another gateway serves the robot; the meshes have forgotten it.
  void on_given_up(const std::string& robot);
  /// A command that no mesh of this gateway carries has ended.
  void on_ended_elsewhere(CommandOutcome outcome) { conclude(std::move(outcome)); }
  /// The store has become full, or has room again; published in `state`.
  void on_store(bool is_full);
  bool is_store_full() const { return is_store_full_; }
  /// The daemon shuts down: publishes the `state` `offline`, as the last will would.
  void on_stop(const Now& now);

  std::optional<GatewayAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  const RobotRegistry& registry() const { return registry_; }
  /// Rights that the broker's access list does not give this gateway, as far as known.
  std::vector<MissingRight> missing_rights() const { return rights_.missing(); }
  std::size_t open_commands() const { return commands_.size(); }
  const Traffic& traffic() const { return traffic_; }
  struct LinkState {
    bool is_up = false;
    std::string detail;
  };
  const LinkState& mesh_link(Mesh mesh) const { return mesh_links_[mesh]; }

 private:
  void handle(Report report, const Now& now);
  void handle(PresenceChange change, const Now& now);
  void handle(SignOfLife sign, const Now& now);
  void handle(SubscribeRequest request, const Now& now);
  void handle(UnsubscribeRequest request, const Now& now);
  void handle(CommandOutcome outcome, const Now& now);
  void handle(LinkChange change, const Now& now);
  void handle(MeshStep step, const Now& now);
  void handle(Notice notice, const Now& now);
  void pass_up(Report report, const Now& now);
  void on_own_question();
  void take_command(BrokerMessage message, const Now& now);
  bool is_stray(const BrokerMessage& message, const std::string& robot) const;
  void deliver_strays(std::vector<StrayCommands::Stray> strays, const Now& now);
  CommandId deliver(BrokerMessage message, const Now& now);
  void deliver_command(const Command& command, BrokerMessage message, const Now& now);
  void refuse(const Command& command, const Now& now);
  std::optional<Mesh> carrier_for(const std::string& robot) const;
  void conclude(CommandOutcome outcome);
  void refuse_unknown(CommandOutcome outcome, const Now& now);
  void publish_outcome(CommandOutcome outcome);
  void end_leftovers(const Now& now);
  void withdraw(const std::string& robot);
  void withdraw_evicted();
  void probe_rights(std::vector<BrokerMessage> messages);
  void answer_waiting_subscribers();
  void reject(TrafficEvent event, bool retain, Robot* robot, const Now& now);
  void on_heard(const std::string& id, Robot* robot, TimePoint now);
  void announce(const std::string& id, Robot& robot, TimePoint now, bool has_just_come = true);
  bool is_covered(const std::string& filter, const SubscriptionTable::Wanted& wanted) const;
  void cover_commands();
  bool hears_commands_live() const { return has_asked_for_all_ && !broker_.keeps_session; }
  void ask_broker(const std::string& filter, const SubscriptionTable::Wanted& wanted);
  void on_own_state(const BrokerMessage& message);
  void publish_retained(std::string topic, std::string payload);

  TopicScheme scheme_;
  const std::string all_commands_ = scheme_.command_topic("+", "+");  ///< the filter
  Settings settings_;
  const BrokerLink& broker_;
  RobotRegistry registry_;
  SubscriptionTable subscriptions_;
  std::optional<TimePoint> subscribers_wait_until_;  ///< while the broker is away
  LeftoverRobots leftovers_;
  RightsProbe rights_;
  std::set<std::string> to_withdraw_;  // retained presence to clear when the broker is back
  OwnershipQuery ownership_;
  PresenceQuery presence_on_;
  CommandLedger commands_;
  StrayCommands strays_;
  LogThrottle unknown_throttle_;
  OpenReceipts open_receipts_;
  Traffic traffic_;
  PerMesh<LinkState> mesh_links_;
  bool is_store_full_ = false;
  bool is_stopping_ = false;
  bool is_state_heard_ = false;     ///< the `online` of this connection has come back
  bool has_asked_for_all_ = false;  ///< commands, for itself
  bool is_all_refused_ = false;     ///< the broker refused the subscription to all commands
  bool was_all_granted_ = false;    ///< in this process
  ActionQueue<GatewayAction> actions_;
};

}  // namespace slamgw
