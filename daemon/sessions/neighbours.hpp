// SPDX-License-Identifier: Apache-2.0
// The other gateways of this broker, as their retained `state` and the presence of their robots
// show them: who serves which robot, and who answers for the robots of one that has died. Pure.
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
  /// Ten times what a gateway says in its state; a larger message is not a gateway's.
  static constexpr std::size_t max_document_octets = 4096;
  /// After a gateway has died, its robots may be heard elsewhere first.
  static constexpr std::chrono::seconds orphan_delay{5};
  /// Each living gateway that comes before this one by name adds this much.
  static constexpr std::chrono::seconds rank_delay{1};

  struct State {
    bool is_online = false;
    std::string version;
    std::string since;
  };
  struct Shown {
    std::string gateway;
    std::string state;  ///< `online`, `asleep`, `offline`
    std::string since;
    std::string document;  ///< as it was retained
  };
  /// A robot whose gateway has died: this gateway answers for it `after` so much time.
  struct Orphan {
    std::string robot;
    Duration after{};
  };

  explicit Neighbours(std::string own_id) : own_id_(std::move(own_id)) {}

  /// The `state` of a gateway; empty when it was withdrawn. What is no such document counts as
  /// offline. Returns the orphans, if the gateway has just gone.
  std::vector<Orphan> on_state(const std::string& gateway, ByteView document);
  /// The presence of a robot at a gateway; empty when it was withdrawn.
  void on_presence(const std::string& gateway, const std::string& robot, ByteView document);

  /// Whether a living gateway other than this one shows the robot.
  bool is_served_elsewhere(const std::string& robot) const;
  /// Whether this gateway is the first by name of those that are online: it refuses commands for
  /// names that no robot has.
  bool is_first() const { return rank() == 0; }

  const std::map<std::string, State>& gateways() const { return gateways_; }
  /// By robot: where it was shown last.
  const std::map<std::string, Shown>& robots() const { return robots_; }

 private:
  void on_withdrawn(const std::string& gateway, const std::string& robot);
  unsigned rank() const;
  bool is_online(const std::string& gateway) const;

  const std::string own_id_;
  std::map<std::string, State> gateways_;  ///< others
  std::map<std::string, Shown> robots_;    ///< of others
  std::map<std::string, Shown> former_;    ///< of `robots_`: what another gateway showed before
};

}  // namespace slamgw::sessions
