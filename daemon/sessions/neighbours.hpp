// SPDX-License-Identifier: Apache-2.0
// The other gateways of this broker, from their retained `state` and the presence of their robots:
// which gateway serves which robot, and when this one answers for a dead gateway's robots. Pure.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::sessions {

class Neighbours {
 public:
  static constexpr std::size_t max_gateways = 1000;
  static constexpr std::size_t max_robots = 20000;
  /// Ten times the size of a gateway's state; a larger message is not from a gateway.
  static constexpr std::size_t max_document_octets = 4096;
  /// Time after a gateway's death in which another gateway may hear its robots first.
  static constexpr std::chrono::seconds orphan_delay{5};
  /// Each living gateway that comes before this one by name adds this time.
  static constexpr std::chrono::seconds rank_delay{1};

  struct State {
    bool is_online = false;
    std::string version;
    std::string since;
    std::string connected;  ///< when it connected to the broker; empty at version 0.1.0
    bool is_shown = true;   ///< on the present connection
  };
  /// The presence of a robot at a gateway.
  struct RobotPresence {
    std::string gateway;
    std::string state;  ///< `online`, `asleep`, `offline`
    std::string since;
    std::string document;  ///< as it was retained
  };
  /// A robot whose gateway has died: this gateway answers for it after the time `after`.
  struct Orphan {
    std::string robot;
    Duration after{};
  };

  explicit Neighbours(std::string own_id) : own_id_(std::move(own_id)) {}

  /// Takes the `state` of a gateway; empty when it was withdrawn. An invalid document counts as
  /// offline. Returns the orphans, if the gateway has just gone offline.
  std::vector<Orphan> on_state(const std::string& gateway, ByteView document);
  /// Takes the presence of a robot at a gateway; empty when it was withdrawn.
  void on_presence(const std::string& gateway, const std::string& robot, ByteView document);

  /// Call at each connection. `is_other`: to another broker, so that all is forgotten.
  void on_broker_up(bool is_other);
  /// Call when the broker, or the gateways themselves, have had time to show the other gateways.
  /// One that was not shown on this connection has died, unless its version shows itself to
  /// newcomers only.
  void on_settled();

  /// Returns the robots of gateways that are not online.
  std::vector<Orphan> orphans() const;
  /// Returns true when another living gateway shows the robot.
  bool is_served_elsewhere(const std::string& robot) const;
  /// Returns true when another living gateway shows the robot as online or asleep.
  bool is_heard_elsewhere(const std::string& robot) const;
  /// Returns true when this gateway is the first by name of the online gateways: it refuses
  /// commands for names that no robot has.
  bool is_first() const { return rank() == 0; }

  const std::map<std::string, State>& gateways() const { return gateways_; }
  /// The last presence of each robot, by robot.
  const std::map<std::string, RobotPresence>& robots() const { return robots_; }

 private:
  void on_withdrawn(const std::string& gateway, const std::string& robot);
  unsigned rank() const;
  bool is_online(const std::string& gateway) const;
  /// Returns true for a gateway that was known as online and is not now.
  bool is_gone(const std::string& gateway) const;

  const std::string own_id_;
  std::map<std::string, State> gateways_;        ///< without this one
  std::map<std::string, RobotPresence> robots_;  ///< of the other gateways
  std::map<std::string, RobotPresence>
      former_;  ///< of `robots_`, the presence at another gateway before
};

}  // namespace slamgw::sessions
