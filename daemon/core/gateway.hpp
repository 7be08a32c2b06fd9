// SPDX-License-Identifier: Apache-2.0
// Connects the meshes with the broker: takes what they report and leaves actions. Pure; knows no
// mesh's protocol and no MQTT client. The application drains its actions.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <variant>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/command_ledger.hpp"
#include "daemon/core/leftover_robots.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/open_receipts.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/retained_topics.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/robot_registry.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/traffic_event.hpp"

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
/// The core keeps nothing of the robot: it had to make room, or an operator wants it so. A session
/// in its mesh stays.
struct RobotForgotten {
  std::string robot;
};
/// A command came for a robot that has said nothing yet but its name.
struct WantSession {
  std::string robot;
};
/// For the gateway itself, at QoS 0.
struct SubscribeAtBroker {
  std::string filter;
};
struct UnsubscribeAtBroker {
  std::string filter;
};
/// `mesh`: the one that carries the command; nothing: to each mesh.
struct DeliverToMesh {
  std::optional<Mesh> mesh;
  RobotMessage message;
};

/// The command has no outcome here: tell the operator who has sent it.
struct CommandHandedOn {
  CommandId id = CommandId::none;
};

using GatewayAction = std::variant<PassUp, Upload, RobotForgotten, WantSession, SubscribeAtBroker,
                                   UnsubscribeAtBroker, DeliverToMesh, CommandOutcome,
                                   CommandHandedOn, TrafficEvent, MeshStep, Notice>;

/// Asks a mesh: MeshAdapter::presence_of.
using PresenceQuery = std::function<std::optional<Presence>(Mesh, const std::string& robot)>;

class Gateway {
 public:
  /// After the broker has come, other gateways' robots become known: until then no name counts as
  /// unknown.
  static constexpr std::chrono::seconds settling{6};
  /// A will waits so long, with the broker there, to learn who holds the robot's session.
  static constexpr std::chrono::seconds will_patience{10};
  /// Wills that wait; beyond it they are published at once.
  static constexpr std::size_t max_waiting_wills = 10000;

  struct Settings {
    std::string version;
    UpdateMode update_mode = UpdateMode::positions;
    WallTime started{};  ///< "since" in `state`
    std::size_t max_open_commands = CommandLedger::default_max_open;
    bool probes_rights = false;               ///< checks the broker's access list (RightsProbe)
    std::vector<std::string> retain = {"*"};  ///< `topics.retain`
  };
  struct Traffic {
    std::uint64_t up = 0;             ///< robots' messages that went to the outbox
    std::uint64_t down = 0;           ///< broker messages that were given to a mesh
    std::uint64_t rejected = 0;       ///< payloads that `payload.update` could not read
    std::uint64_t late_outcomes = 0;  ///< of commands that had ended already
    std::uint64_t not_retained = 0;   ///< published without the retain flag that they had
  };

  /// `broker` outlives it.
  Gateway(TopicScheme scheme, Settings settings, const BrokerLink& broker,
          PresenceQuery presence_on);

  void on_mesh_event(MeshEvent event, const Now& now);
  /// From the gateway's own connection: what it has subscribed to for itself.
  void on_broker_message(BrokerMessage message, const Now& now);
  /// From the robot's session: nobody else has this message. Its `command` is given here.
  void on_robot_message(RobotMessage message, const Now& now);
  /// A command that waited at the broker for too long while no gateway held the robot's session, or
  /// whose robot `has_begun_anew`.
  void on_stale_command(const std::string& robot, BrokerMessage message, bool has_begun_anew,
                        const Now& now);
  /// A command that an operator sends. The id comes back in a CommandOutcome.
  CommandId on_operator_command(const std::string& robot, const std::string& type, Bytes payload,
                                const Now& now);
  /// The link to the broker came up or went down. Up: subscribes everything again and publishes
  /// `online` and every robot's presence again, because a broker without persistence has forgotten
  /// them.
  void on_broker_link(const Now& now);
  void on_subscribe_result(const std::string& filter, bool is_granted, const Now& now);
  /// A subscription of the gateway itself, to hear other gateways; renewed at each connection.
  void subscribe_own(const std::string& filter);
  void unsubscribe_own(const std::string& filter);
  /// Commands for all names: this gateway refuses those for names that no robot has.
  void hear_all_commands(bool does_hear);
  /// Another gateway has come that may not have seen what this one has retained.
  void announce_all(const Now& now);
  /// What this gateway says of itself, retained; also published when it changes, and at each
  /// connection.
  void publish_state();
  /// The receipt of a Report has fired; updates the robot's numbers.
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now);
  /// The ids in `robots` of the configuration: these robots are never evicted. A robot that has
  /// left the configuration and is offline is forgotten.
  void on_configured(std::set<std::string> robots, const Now& now);
  /// Commands to banned robots are refused from now on.
  void set_names(RobotNames names) { names_ = std::move(names); }
  /// Removes a robot from the registry and its retained presence from the broker, also a robot that
  /// only an earlier process knew. Returns why that is not possible; empty when done.
  std::string forget(const std::string& robot);
  void ask_where_robots_are(RobotPlaces places) { places_ = std::move(places); }
  /// This gateway holds the robot's session from now on. `was_present`: the broker knew it.
  /// `dead_owner`: the gateway that showed the robot last and is gone; may be empty.
  void on_session_held(const std::string& robot, bool was_present, const std::string& dead_owner,
                       const Now& now);
  /// Another gateway serves the robot; the meshes have forgotten it.
  void on_given_up(const std::string& robot);
  /// The command goes to the robot's next gateway, which tells its outcome.
  void on_handed_on(CommandId command);
  /// Another client takes the robot's session again and again, or does so no longer.
  void on_contested(const std::string& robot, bool is_contested, const Now& now);
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
  const RetainedTopics& retained() const { return retained_; }
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
  /// Its retained topics still count. Otherwise, new names could retain without end.
  void handle(SessionEvicted evicted, const Now&) { drop(evicted.robot); }
  void handle(CommandOutcome outcome, const Now& now);
  void handle(LinkChange change, const Now& now);
  void handle(MeshStep step, const Now& now);
  void handle(Notice notice, const Now& now);
  /// The rest is about robots' sessions.
  template <class Other>
  void handle(const Other&, const Now&) {}
  std::string drop(const std::string& robot);
  bool may_retain(const Report& report, std::string_view type, const Now& now);
  void pass_up(Report report, const Now& now);
  CommandId deliver(RobotMessage message, const Now& now);
  void refuse_strays(const Now& now);
  void refuse_stray(const StrayCommands::Stray& stray, const Now& now);
  void publish_waiting_wills(const Now& now);
  void refuse(const Command& command, const Now& now);
  std::optional<Mesh> carrier_for(const std::string& robot) const;
  void conclude(CommandOutcome outcome);
  void refuse_unknown(CommandOutcome outcome, const Now& now);
  void publish_outcome(CommandOutcome outcome);
  void end_leftovers(const Now& now);
  void withdraw(const std::string& robot);
  void withdraw_evicted();
  void probe_rights(std::vector<BrokerMessage> messages);
  void reject(TrafficEvent event, bool retain, Robot* robot, const Now& now);
  void on_heard(const std::string& id, Robot* robot, TimePoint now);
  void announce(const std::string& id, Robot& robot, TimePoint now);
  void on_own_state(const BrokerMessage& message, const Now& now);
  bool knows_others(TimePoint now) const;
  void announce_unheld(const Now& now);
  void publish_retained(std::string topic, std::string payload);

  TopicScheme scheme_;
  const std::string all_commands_ = scheme_.command_topic("+", "+");  ///< the filter
  Settings settings_;
  const BrokerLink& broker_;
  RobotRegistry registry_;
  RobotNames names_;
  std::set<std::string> own_filters_;
  std::optional<TimePoint> up_since_;            ///< the broker
  std::map<std::string, Report> waiting_wills_;  ///< by robot
  std::optional<TimePoint> wills_due_;
  std::optional<TimePoint> announce_at_;  ///< robots whose sessions are not held
  LeftoverRobots leftovers_;
  RightsProbe rights_;
  std::set<std::string> to_withdraw_;  // retained presence to clear when the broker is back
  RobotPlaces places_;
  PresenceQuery presence_on_;
  CommandLedger commands_;
  StrayCommands strays_;
  LogThrottle unknown_throttle_;
  RetainedTopics retained_;
  LogThrottle retained_throttles_[2];  // by whether the client is proven
  OpenReceipts open_receipts_;
  Traffic traffic_;
  PerMesh<LinkState> mesh_links_;
  bool is_store_full_ = false;
  bool is_stopping_ = false;
  bool sends_retained_ = false;  ///< the broker does, to subscriptions with wildcards
  bool is_state_heard_ = false;  ///< the `online` of this connection has come back
  ActionQueue<GatewayAction> actions_;
};

}  // namespace slamgw
