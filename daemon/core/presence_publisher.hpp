// SPDX-License-Identifier: Apache-2.0
// Publishes what the broker retains of this gateway: its `state`, and the presence of each robot
// that it serves. Keeps both right after a restart, beside other gateways, and when the broker has
// forgotten them. With `topics.home_assistant` also publishes each robot's document for Home
// Assistant.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/broker_link.hpp"
#include "daemon/core/gateway_actions.hpp"
#include "daemon/core/gateway_settings.hpp"
#include "daemon/core/robot_directory.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

class PresencePublisher {
 public:
  /// Time after the broker came online until other gateways' robots are known. Until then no name
  /// counts as unknown.
  static constexpr std::chrono::seconds settling{6};
  /// Time that a will waits, with the broker online, until it is known which gateway holds the
  /// robot's session.
  static constexpr std::chrono::seconds will_patience{10};
  /// Wills that may wait; further wills are published at once.
  static constexpr std::size_t max_waiting_wills = 10000;

  /// An earlier process may have left robots as online. Time from the first connection to the
  /// broker in which living robots are heard again: BLE robots send a health status every 10 s;
  /// sessions of MQTT-SN clients are restored at the start.
  static constexpr std::chrono::seconds leftover_grace{40};
  static constexpr std::size_t max_leftovers = 10000;
  /// Ten times the size of a presence that the gateway writes; no gateway wrote a larger one.
  static constexpr std::size_t max_leftover_octets = 4096;

  /// The references must outlive this object.
  PresencePublisher(const TopicScheme& scheme, GatewaySettings& settings, const BrokerLink& broker,
                    RobotDirectory& directory, GatewayActions& actions);

  void on_broker_link(const Now& now);
  /// True when the message is the gateway's own state or presence; the caller drops it.
  bool take(const BrokerMessage& message, const Now& now);
  void on_presence(const PresenceChange& change, const Now& now);
  /// Takes a message or another sign of life of a robot. `robot` is null when there is no room for
  /// it.
  void on_heard(const std::string& id, Robot* robot, TimePoint now);
  /// Publishes the robot's presence, unless another gateway shows the robot. Publishes none for a
  /// robot that has only sent messages, without a session.
  void announce(const std::string& id, Robot& robot, TimePoint now);
  void announce_all(const Now& now);
  /// Applies `topics.home_assistant` after the configuration was read again.
  void describe_robots(bool is_wanted, const Now& now);
  /// Publishes this gateway's `state`. Also called at each connection.
  void publish_state();
  /// The message store has become full or has room again: `state` shows it.
  void on_store(bool is_full);
  bool is_store_full() const { return is_store_full_; }
  void on_stop();

  /// Keeps the will and returns true when the robot may be alive at another gateway.
  bool keep_will(Report& will, const Now& now);
  std::optional<Report> take_will(const std::string& robot);
  /// Removes the waiting wills whose time is over. Returns those of robots that no other gateway
  /// serves.
  std::vector<Report> take_due_wills(const Now& now);

  /// `dead_owner`: the gateway that showed the robot last and is gone; may be empty.
  void on_session_held(const std::string& robot, const std::string& dead_owner, const Now& now);
  /// Another gateway serves the robot; the meshes have forgotten it.
  void on_given_up(const std::string& robot);
  /// Another client takes the robot's session again and again, or no longer does so.
  void on_contested(const std::string& robot, bool is_contested, const Now& now);
  /// Removes a robot from the registry and its retained presence from the broker. Returns why that
  /// is not possible; empty when done.
  std::string drop(const std::string& robot);
  /// Withdraws the presence of robots that the registry has evicted.
  void withdraw_evicted();

  /// Returns when other gateways' robots are known; nothing while the broker is offline.
  std::optional<TimePoint> settled_at() const;
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

 private:
  struct WaitingWill {
    Report report;
    TimePoint came{};
  };

  void on_own_state(const BrokerMessage& message, const Now& now);
  bool knows_others(TimePoint now) const;
  void announce_unheld(const Now& now);
  void on_own_presence(const BrokerMessage& message);
  void end_leftovers(const Now& now);
  void withdraw(const std::string& robot);
  void describe(const std::string& id, Robot& robot);
  void clear_retained(std::string topic);
  void publish_retained(std::string topic, std::string_view payload);

  const TopicScheme& scheme_;
  GatewaySettings& settings_;
  const BrokerLink& broker_;
  RobotDirectory& directory_;
  GatewayActions& actions_;
  const std::string own_presence_;  ///< the beginning of the topics of this gateway's presence
  /// Presence that an earlier process retained, by robot; nothing once `leftover_grace` is over.
  std::optional<std::map<std::string, std::string>> leftovers_{std::in_place};
  std::optional<TimePoint> leftovers_due_;
  std::optional<TimePoint> up_since_;     ///< when the broker came online
  std::optional<TimePoint> announce_at_;  ///< when to announce robots whose sessions are not held
  std::map<std::string, WaitingWill> waiting_wills_;  ///< by robot
  /// When to look for wills whose time is over: no later than the first one's due time.
  std::optional<TimePoint> wills_due_;
  std::set<std::string> to_clear_;  ///< retained topics to clear when the broker is back
  bool is_store_full_ = false;
  bool is_stopping_ = false;
  /// The broker has sent a retained message on this connection, so it does for wildcards.
  bool sends_retained_ = false;
  bool is_state_heard_ = false;  ///< the `online` of this connection has come back
};

}  // namespace slamgw
