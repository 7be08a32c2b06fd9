// SPDX-License-Identifier: Apache-2.0
// Connects the meshes with the broker: takes the meshes' events and leaves actions. Handles robots'
// messages itself; Commands handles the way down, PresencePublisher what the broker retains of
// robots. Pure; knows no mesh's protocol and no MQTT client. The application drains its actions.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/commands.hpp"
#include "daemon/core/copy_filter.hpp"
#include "daemon/core/gateway_actions.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/presence_publisher.hpp"
#include "daemon/core/recycling_allocator.hpp"
#include "daemon/core/retained_topics.hpp"
#include "daemon/core/rights_probe.hpp"
#include "daemon/core/robot_directory.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

class Gateway {
 public:
  using Settings = GatewaySettings;
  struct Traffic {
    std::uint64_t up = 0;            ///< robots' messages, rejected ones included
    PerMesh<std::uint64_t> up_on{};  ///< the same, by mesh
    std::uint64_t rejected = 0;      ///< payloads that `payload.update` could not read
    std::uint64_t not_retained = 0;  ///< messages published without the retain flag that they had
  };

  /// `broker` must outlive the gateway.
  Gateway(TopicScheme scheme, Settings settings, const BrokerLink& broker,
          PresenceQuery presence_on);

  void on_mesh_event(MeshEvent event, const Now& now);
  /// Takes a message of the gateway's own connection, which brings its own subscriptions.
  void on_broker_message(BrokerMessage message, const Now& now);
  /// The link to the broker came up or went down. Up: subscribes everything again and publishes
  /// `online` and every robot's presence again, because a broker without persistence has forgotten
  /// them.
  void on_broker_link(const Now& now);
  void on_subscribe_result(const std::string& filter, bool is_granted, const Now& now);
  /// Subscribes for the gateway itself, to hear other gateways; renewed at each connection.
  void subscribe_own(const std::string& filter);
  void unsubscribe_own(const std::string& filter);
  /// Starts or stops hearing commands for all names. A gateway that hears them refuses commands for
  /// names that no robot has.
  void hear_all_commands(bool does_hear);
  /// The receipt of a Report has fired; updates the numbers of the robot and of its mesh.
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now);
  /// Takes the ids in `robots` of the configuration: these robots are never evicted. Forgets a
  /// robot that has left the configuration and is offline.
  void on_configured(std::set<std::string> robots);
  /// Commands to banned robots are refused from now on.
  void set_names(RobotNames names) { directory_.names = std::move(names); }
  /// Removes a robot from the registry and its retained presence from the broker, also a robot that
  /// only an earlier process knew. Returns why that is not possible; empty when done.
  std::string forget(const std::string& robot);
  /// Sets the answers to questions about other gateways' robots.
  void set_places(RobotPlaces places) { directory_.places = std::move(places); }
  /// This gateway holds the robot's session from now on. `was_present`: the broker knew it.
  /// `dead_owner`: the gateway that showed the robot last and is gone; may be empty.
  void on_session_held(const std::string& robot, bool was_present, const std::string& dead_owner,
                       const Now& now);
  /// This gateway still held the robot's session after the last report.
  void on_session_proven(const std::string& robot, const Now& now);
  /// The daemon shuts down: publishes the `state` `offline`, as the last will would.
  void on_stop(const Now& now);

  Commands& commands() { return commands_; }
  const Commands& commands() const { return commands_; }
  PresencePublisher& presence() { return presence_; }
  const PresencePublisher& presence() const { return presence_; }

  std::optional<GatewayAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  const RobotRegistry& registry() const { return directory_.registry; }
  bool is_banned(const std::string& robot) const { return directory_.names.is_banned(robot); }
  /// Rights that the broker's access list does not give this gateway, as far as known.
  std::vector<MissingRight> missing_rights() const { return rights_.missing(); }
  const RetainedTopics& retained() const { return retained_; }
  const Traffic& traffic() const { return traffic_; }
  struct LinkState {
    bool is_up = false;
    std::string detail;
  };
  const LinkState& mesh_link(Mesh mesh) const { return mesh_links_[mesh]; }
  /// Times from a message's arrival until the broker or the disk had it.
  const LatencyHistogram& latencies(Mesh mesh) const { return latencies_[mesh]; }

 private:
  /// Messages with an open receipt beyond this bound have no latency. It is far above what the
  /// meshes leave open.
  static constexpr std::size_t max_open_receipts = 65536;
  using ReceiptKey = std::pair<Mesh, std::uint64_t>;
  struct Arrival {
    std::string robot;
    TimePoint at{};
  };

  void handle(Report report, const Now& now);
  void handle(const PresenceChange& change, const Now& now) { presence_.on_presence(change, now); }
  void handle(SignOfLife sign, const Now& now);
  /// Keeps counting the robot's retained topics. Otherwise, new names could retain without end.
  void handle(SessionEvicted evicted, const Now&) { presence_.drop(evicted.robot); }
  void handle(CommandOutcome outcome, const Now& now) {
    commands_.on_outcome(std::move(outcome), now);
  }
  void handle(LinkChange change, const Now& now);
  void handle(MessageStep step, const Now& now);
  void handle(Notice notice, const Now&) { actions_.push(std::move(notice)); }
  /// Ignores events about robots' sessions.
  template <class Other>
  void handle(const Other&, const Now&) {}
  bool may_retain(const Report& report, std::string_view type, bool is_clearing, const Now& now);
  bool is_copy(const Report& report, const Now& now);
  void pass_up(Report report, const Now& now);
  void reject(TrafficEvent event, Robot* robot, const Now& now);

  TopicScheme scheme_;
  const std::string all_commands_ = scheme_.command_topic("+", "+");  ///< as a filter
  Settings settings_;
  const BrokerLink& broker_;
  GatewayActions actions_;
  RobotDirectory directory_;
  CopyFilter copies_;
  PresencePublisher presence_;
  Commands commands_;
  RightsProbe rights_;
  std::set<std::string> own_filters_;
  RetainedTopics retained_;
  LogThrottle retained_throttles_[2];  // indexed by Report::is_proven
  std::map<ReceiptKey, Arrival, std::less<>,
           RecyclingAllocator<std::pair<const ReceiptKey, Arrival>>>
      open_receipts_;
  Traffic traffic_;
  PerMesh<LinkState> mesh_links_;
  PerMesh<LatencyHistogram> latencies_;
};

}  // namespace slamgw
