// SPDX-License-Identifier: Apache-2.0
// This gateway among others on its broker (docs/fleet.md): the sessions of its robots, the robots
// that other gateways show, and the choice of the board for a robot that several boards hear. The
// shell around SessionHost, Neighbours and BoardChoice: passes the actions of each to the others.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <set>
#include <string>

#include "daemon/app/last_alive.hpp"
#include "daemon/app/meshes.hpp"
#include "daemon/config/config.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/runtime/machine_driver.hpp"
#include "daemon/runtime/timer.hpp"
#include "daemon/sessions/board_choice.hpp"
#include "daemon/sessions/io/session_host.hpp"
#include "daemon/sessions/neighbours.hpp"

namespace slamgw {

class FleetMember {
 public:
  /// Publishes through the outbox.
  using Submit = std::function<void(BrokerMessage)>;

  /// The references must outlive this object.
  FleetMember(boost::asio::io_context& io, const Config& config, const TopicScheme& scheme,
              Gateway& gateway, MachineDriver<Gateway>& gateway_driver, Meshes& meshes,
              Upstream& upstream, Submit submit);

  void start();
  void on_broker_link(bool is_up);
  void on_silence(bool is_silent);
  /// Takes each event of a mesh before the core does.
  void on_mesh_event(const MeshEvent& event);
  /// Takes a message of the gateway's own connection. True when the message is about other
  /// gateways.
  bool takes(const BrokerMessage& message);
  void perform(RobotForgotten& action);
  void perform(WantSession& action);
  /// The answer to `slam-gatewayctl fleet`; this gateway is the first row.
  nlohmann::ordered_json status() const;
  Counters counters() const { return host_.sessions().counters(); }
  /// Stops taking messages for robots; their sessions stay at the broker. Call it before the meshes
  /// stop, and until it returns true: they get what the broker has given to this gateway.
  bool stop_taking() { return host_.stop_taking(); }
  /// Closes all connections without waiting; robots' sessions stay at the broker.
  void stop();

 private:
  /// A gateway that starts leaves its former robots this long to other gateways that hear them.
  static constexpr std::chrono::seconds former_delay{2};
  /// Time after the broker came online until the other gateways' presence is known.
  static constexpr std::chrono::seconds settling{2};
  /// Newcomers within this time share one repetition of this gateway's presence.
  static constexpr std::chrono::seconds newcomer_delay{1};
  /// Up to this many gateways, each newcomer has its own log line; beyond, a burst has one.
  static constexpr std::size_t max_newcomer_lines = 16;
  static constexpr std::chrono::seconds tick_interval{1};
  /// A gateway needs milliseconds to withdraw the presence of a robot that another one has taken.
  static constexpr std::chrono::milliseconds withdrawal_patience{300};

  RobotPlaces places();
  bool is_held(const std::string& robot) const { return host_.sessions().is_held(robot); }
  /// True when this gateway holds the robot, or another one, living or not, shows it.
  bool is_shown(const std::string& robot) const {
    return is_held(robot) || neighbours_.robots().contains(robot);
  }
  /// Returns true for a while after this process stood still: another gateway may serve its robots,
  /// and its board has kept the messages of the pause. Two gateways must not both acknowledge them.
  bool is_waking() const { return host_.sessions().is_waking(read_clocks().mono); }
  bool is_settled() const;
  void handle(const SubscribeRequest& request);
  void handle(const UnsubscribeRequest& request);
  void handle(const SessionCleaned& cleaned);
  void handle(const NoteChanged& change);
  void handle(const NoteRequest& request);
  void handle(const SignOfLife& sign) { on_heard(sign.mesh, sign.robot); }
  void handle(const Report& report);
  void handle(const PresenceChange& change);
  void handle(const LinkChange& change);
  template <class Other>
  void handle(const Other&) {}
  void on_heard(Mesh mesh, const std::string& robot);
  void on_heard_by_board(const std::string& robot, const std::optional<RadioFacts>& radio);
  bool should_attach(const std::string& robot);
  void attach(const std::string& robot);
  void keep(const std::string& robot, std::optional<TimePoint> unheld_since, Duration after);
  void give_up(const std::string& robot);
  void give_up_lost();
  void on_state(const std::string& gateway, const BrokerMessage& message);
  void log_newcomer(const std::string& gateway, TimePoint now);
  bool on_presence(const std::string& gateway, const std::string& robot,
                   const BrokerMessage& message);
  bool has_moved(const std::string& robot) const;
  bool is_here(const std::string& robot) const;
  void keep_orphans();
  void withdraw_from_still_gateways();
  void withdraw_from(const std::string& gateway, const std::string& robot);
  void on_tick();
  void perform(sessions::SessionHost::Report& report);
  void on_held(const sessions::SessionHeld& held);
  void on_lost(const sessions::SessionLost& lost);
  std::string adopt(const std::string& robot);
  const char* state() const;
  nlohmann::ordered_json gateways() const;
  nlohmann::ordered_json robots() const;

  const TopicScheme scheme_;
  const sessions::SessionNames names_;
  Gateway& gateway_;
  MachineDriver<Gateway>& gateway_driver_;
  Meshes& meshes_;
  Upstream& upstream_;
  const Submit submit_;
  const WallTime started_;
  LastAlive last_alive_;
  sessions::Neighbours neighbours_;
  sessions::BoardChoice board_choice_;
  sessions::SessionHost host_;
  Timer tick_;
  Timer newcomer_timer_;
  LogThrottle newcomer_lines_;
  std::optional<TimePoint> up_since_;  ///< when the broker came online
  TimePoint last_up_{};                ///< when it was online last
  std::string broker_uri_;             ///< of the newest connection, also of the former process
  bool has_kept_orphans_ = false;
  bool sends_retained_ = false;  ///< the broker sends retained messages to wildcard subscriptions
  std::set<std::string> lost_;   ///< robots lost to an unknown gateway and not heard since
  std::map<std::string, TimePoint> taken_;  ///< robots of gateways that may not have noticed yet
  /// Robots whose sessions were held when the broker went offline: they are still served.
  std::set<std::string> held_before_;
  /// By robot, the presence that this gateway shows in place of a gateway that has died.
  std::map<std::string, std::string> adopted_;
};

}  // namespace slamgw
