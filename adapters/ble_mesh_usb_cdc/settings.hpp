// SPDX-License-Identifier: Apache-2.0
// The configuration of BLE Mesh (`ble_mesh.*`, `presence.*`); defaults as in config/gateway.json.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace slamgw::ble {

enum class RadioChoice : std::uint8_t { nordic, bluez };
enum class Protocol : std::uint8_t { nordic_serial, cobs };
enum class FlowControl : std::uint8_t { automatic, none, rts_cts };
enum class OnOffModel : std::uint8_t { generic, simple };
enum class CobsContent : std::uint8_t { positions, lien };

struct ProvisioningSettings {
  bool enabled = true;
  std::vector<std::string> uuid_prefixes;  ///< hex, any case
  std::optional<std::string> static_oob;   ///< secret: never logged
  bool over_mqtt = false;                  ///< clients of the broker may permit joining
  bool operator==(const ProvisioningSettings&) const = default;
};

struct WillSettings {
  std::string topic;  ///< `{id}` stands for the robot
  std::string message;
  bool operator==(const WillSettings&) const = default;
};

/// Robots that the gateway configures publish their health at this interval, besides all else.
inline constexpr std::chrono::seconds health_interval{10};

struct Settings {
  bool enabled = false;
  RadioChoice radio = RadioChoice::nordic;
  std::string controller = "hci0";  ///< of bluetooth-meshd, with `bluez`
  std::string device = "auto";      ///< a path, or `auto`
  Protocol protocol = Protocol::nordic_serial;
  unsigned baud_rate = 115200;
  FlowControl flow_control = FlowControl::automatic;
  std::uint16_t address = 0x0001;  ///< the gateway's unicast address
  std::uint8_t ttl = 4;            ///< 0, 2-127
  std::vector<std::uint16_t> groups = {0xc002, 0xc003, 0xc004};
  /// The group that robots publish to, so that the radios of several gateways hear them. Empty:
  /// robots publish to `address`.
  std::optional<std::uint16_t> gateway_group;
  /// Topic filters below the prefix. They select the robots whose updates are relayed to the robots
  /// of this mesh, in `relay_group`.
  std::vector<std::string> relay;
  std::uint16_t relay_group = 0xc100;
  std::string min_com_type = "adv";
  std::string sensor_update_type = "update";
  std::string pos_cmd_type = "cmd";
  OnOffModel on_off_model = OnOffModel::generic;
  ProvisioningSettings provisioning;
  std::optional<WillSettings> will;
  CobsContent cobs_content = CobsContent::positions;
  std::optional<std::string> robot_id;
  std::chrono::seconds offline_after{30};  ///< `presence.offline_after_s`
  bool operator==(const Settings&) const = default;

  /// The groups that the radio hears.
  std::vector<std::uint16_t> heard_groups() const {
    std::vector<std::uint16_t> heard = groups;
    if (gateway_group) heard.push_back(*gateway_group);
    return heard;
  }
  /// Returns the address that robots publish to.
  std::uint16_t destination() const { return gateway_group.value_or(address); }
  /// Returns the group in which robots hear relayed updates; nothing if none are relayed.
  std::optional<std::uint16_t> relayed_to() const {
    return relay.empty() ? std::nullopt : std::optional(relay_group);
  }
};

}  // namespace slamgw::ble
