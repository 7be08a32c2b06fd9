// SPDX-License-Identifier: Apache-2.0
// The robots of a BLE mesh, and `ble_mesh.will`: the report that the gateway publishes for a robot
// that went silent. Called by the meshes.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/robots/downlink.hpp"
#include "daemon/core/log_throttle.hpp"

namespace slamgw::ble {

/// `{id}` in the topic stands for `robot`; the message is taken as it is.
Report will_report(const WillSettings& will, std::string_view robot);

/// The robots on the mesh: names, presence, and subscriptions at the broker. Part of BleMesh.
class Robots : private MeshPart {
 public:
  /// Six times the replay list of a stock serial board, which can't hear a larger mesh.
  static constexpr std::size_t max_robots = 256;

  /// All references must outlive this object.
  Robots(const MeshPart& shared, const NodeTable& nodes, Downlink& downlink)
      : MeshPart(shared), nodes_(nodes), downlink_(downlink) {}

  auto begin() { return robots_.begin(); }
  auto end() { return robots_.end(); }
  auto begin() const { return robots_.begin(); }
  auto end() const { return robots_.end(); }

  /// Returns the robot that has this address on any of its elements, and adds it if it is new.
  /// Returns null if there is no room for it.
  Robot* at(std::uint16_t source, TimePoint now);
  /// Returns the robot with this address on its first element, or null.
  Robot* find(std::uint16_t address);
  Robot* find(std::string_view id);
  const Robot* find(std::string_view id) const;
  std::uint64_t online() const;
  /// Returns the number of robots that are online and do not hear the gateway.
  std::uint64_t deaf() const;
  /// `asking` robots are online and have sent acknowledged messages since the radio came up. The
  /// `deaf` among them have not heard the gateway since.
  struct Hearing {
    std::size_t deaf = 0;
    std::size_t asking = 0;
    /// Returns true if more than half are deaf, and at least two: one can have a fault of its own.
    bool is_mostly_deaf() const { return deaf >= 2 && 2 * deaf > asking; }
  };
  Hearing hearing() const;

  /// Adds the robots that the configuration and the database of nodes name.
  void on_start();
  /// Adds and removes robots. Call when the nodes have changed.
  void on_nodes_changed(TimePoint now);
  /// Names of nodes have changed. Open receipts of a renamed robot stay open.
  void on_names(TimePoint now);

  void on_link_up(TimePoint now);
  /// This gateway serves the robot from now on: reports its presence.
  void on_session_held(Robot& robot, TimePoint now);
  /// Another gateway serves the robot: it is announced again when it comes back.
  void on_given_up(Robot& robot);
  void on_heard(Robot& robot, TimePoint now);
  /// The robot was seen to hear the gateway, or not to hear it.
  void on_hearing(Robot& robot, bool is_deaf);
  /// Marks the robot as offline when it was silent for too long.
  void on_deadline(Robot& robot, TimePoint now);
  void on_subscribe_result(const std::string& id, bool granted);
  /// Asks again for the topics that the broker did not grant.
  void on_broker_up();

 private:
  auto add(std::uint16_t address, const std::string& id) {
    return robots_.try_emplace(address, address, id, settings_.ttl);
  }
  bool make_room(TimePoint now);
  void add_configured();
  void warn_of_taken_name(const std::string& name, std::uint16_t address);
  void apply_ban(Robot& robot, TimePoint now);
  void leave_name(Robot& robot, const std::string& why, TimePoint now);
  void take_name(Robot& robot, std::string id, TimePoint now);
  void announce(Robot& robot, Presence presence);
  void subscribe_known(const Robot& robot);
  /// `is_here`: asks for retained messages too, and counts as a sign that the robot is here.
  void subscribe(const Robot& robot, bool is_here);

  const NodeTable& nodes_;
  Downlink& downlink_;
  std::map<std::uint16_t, Robot> robots_;
  bool is_started_ = false;
  LogThrottle full_throttle_;
};

}  // namespace slamgw::ble
