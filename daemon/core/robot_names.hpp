// SPDX-License-Identifier: Apache-2.0
// Which robot an address on a mesh is: what `robots` in the configuration says, else the defaults
// of docs/topics.md. Immutable.
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

/// One entry of `robots`: a fixed name, the addresses it goes by on either mesh, and its origin for
/// programs that draw maps. The gateway itself changes no position.
struct RobotName {
  std::string id;
  std::optional<std::uint16_t> ble_address;     ///< unicast address, 0x0001-0x7fff
  std::optional<std::string> mqttsn_client_id;  ///< compared whole
  std::optional<RobotOrigin> origin{};
  /// IpNetwork's text: over MQTT-SN the robot comes from there alone.
  std::optional<std::string> address{};
  /// Over which mesh it is commanded when both reach it; nothing: CarrierChoice says it.
  std::optional<Mesh> prefer{};
  bool operator==(const RobotName&) const = default;
};

class RobotNames {
 public:
  explicit RobotNames(std::vector<RobotName> names = {}, Bans bans = Bans());

  /// `robots`' id for this unicast address, else `ble-<4 hex digits>`.
  std::string of_ble(std::uint16_t address) const;
  /// `robots`' id for this client id, else the client id itself. Nothing when `robots` gives that
  /// name to another client id: a device speaks only for itself; and when either name is banned.
  std::optional<std::string> of_client(std::string_view client_id) const;
  /// False when `robots` gives this id, or MQTT-SN client id, an address that does not cover
  /// `from`.
  bool may_come_from(std::string_view id, const IpNetwork::Address& from) const;
  /// The unicast address that goes by this id, also for `ble-<4 hex digits>`.
  std::optional<std::uint16_t> ble_address_of(std::string_view id) const;
  /// Whether a ban of its name, or of the only name that it has on a mesh, keeps this robot out.
  bool is_banned(std::string_view id) const;
  /// It has an address on both meshes.
  bool is_on_both(std::string_view id) const { return on_both_.contains(id); }
  /// RobotName::prefer of a robot on both; nothing for others.
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
