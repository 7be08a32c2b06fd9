// SPDX-License-Identifier: Apache-2.0
// Maps addresses on a mesh to robots' names: those of `robots` in the configuration, else the
// defaults of docs/topics.md. Immutable.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/core/bans.hpp"
#include "daemon/core/mesh.hpp"

namespace slamgw {

/// Where a robot's coordinate frame lies in the room: the position of its (0, 0), and how far its x
/// axis is turned from the room's, counter-clockwise.
struct RobotOrigin {
  double x_cm = 0;
  double y_cm = 0;
  double heading_deg = 0;
  bool operator==(const RobotOrigin&) const = default;
};

/// One entry of `robots`: a fixed name, the robot's addresses on both meshes, and its origin for
/// programs that draw maps. The gateway itself changes no position.
struct RobotName {
  std::string id;
  std::optional<std::uint16_t> ble_address;     ///< unicast address, 0x0001-0x7fff
  std::optional<std::string> mqttsn_client_id;  ///< compared whole
  std::optional<RobotOrigin> origin{};
  /// IpNetwork as text: over MQTT-SN the robot may come only from there.
  std::optional<std::string> address{};
  /// The mesh for commands when both reach the robot; nothing: CarrierChoice decides.
  std::optional<Mesh> prefer{};
  bool operator==(const RobotName&) const = default;
};

class RobotNames {
 public:
  explicit RobotNames(std::vector<RobotName> names = {}, Bans bans = Bans());

  /// Returns the id that `robots` gives this unicast address, else `ble-<4 hex digits>`.
  std::string of_ble(std::uint16_t address) const;
  /// Returns the id that `robots` gives this client id, else the client id itself. Returns nothing
  /// when that name belongs to another device, because a device speaks only for itself, or when
  /// either name is banned.
  std::optional<std::string> of_client(std::string_view client_id) const;
  /// True when the client id is banned, or the name that `robots` gives this client.
  bool is_client_banned(std::string_view client_id) const;
  /// False when `robots` gives this id, or MQTT-SN client id, an address that does not cover
  /// `from`.
  bool may_come_from(std::string_view id, const IpNetwork::Address& from) const;
  /// Returns the unicast address of the robot with this id, also for `ble-<4 hex digits>`.
  std::optional<std::uint16_t> ble_address_of(std::string_view id) const;
  /// True when the robot's id is banned, or its client id if the robot has no BLE address.
  bool is_banned(std::string_view id) const;
  /// True when `robots` gives the robot an address on both meshes.
  bool is_on_both(std::string_view id) const { return on_both_.contains(id); }
  /// Returns RobotName::prefer of a robot on both meshes; nothing for others.
  std::optional<Mesh> preferred(std::string_view id) const {
    const auto known = on_both_.find(id);
    return known == on_both_.end() ? std::nullopt : known->second;
  }
  const std::vector<RobotName>& configured() const { return names_; }
  const Bans& bans() const { return bans_; }

 private:
  std::vector<RobotName> names_;
  Bans bans_;
  std::map<std::uint16_t, std::string> by_ble_;
  std::map<std::string, std::string, std::less<>> by_client_;
  std::map<std::string, std::optional<Mesh>, std::less<>> on_both_;
  std::map<std::string, IpNetwork, std::less<>> networks_;  ///< by id and by client id
};

}  // namespace slamgw
