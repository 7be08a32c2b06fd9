// SPDX-License-Identifier: Apache-2.0
// The flash of a robot's mesh stack (Mesh Profile 1.0 section 4.2): keys, models, their bindings,
// publications and subscriptions. Plain values; ConfigServer changes them, Node applies them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "simulation/ble/provisioning_pdu.hpp"

namespace slamgw::sim::ble {

struct ModelId {
  static constexpr std::uint16_t sig = 0xffff;  ///< company of the Bluetooth SIG's own models

  std::uint16_t company = sig;
  std::uint16_t id = 0;

  bool operator==(const ModelId&) const = default;
};

constexpr std::uint16_t nordic = 0x0059;
constexpr ModelId configuration_server{ModelId::sig, 0x0000};
constexpr ModelId health_server{ModelId::sig, 0x0002};
constexpr ModelId generic_on_off_server{ModelId::sig, 0x1000};
constexpr ModelId simple_on_off_server{nordic, 0x0000};
constexpr ModelId min_com_client{nordic, 0x0004};
constexpr ModelId min_com_server{nordic, 0x0005};
constexpr ModelId sensor_update_client{nordic, 0x0006};
constexpr ModelId pos_cmd_client{nordic, 0x0008};
constexpr ModelId pos_cmd_server{nordic, 0x0009};

constexpr std::uint8_t use_default_ttl = 0xff;  ///< of a publication

struct ModelPublication {
  Address address = 0;
  std::uint16_t app_key_index = 0;
  bool has_friendship_credential = false;
  std::uint8_t ttl = 0;
  std::uint8_t period = 0;      ///< steps and resolution as on air (section 4.2.2.2)
  std::uint8_t retransmit = 0;  ///< stored without effect

  bool operator==(const ModelPublication&) const = default;
};

struct Model {
  ModelId id;
  std::vector<std::uint16_t> bindings;  ///< application key indexes
  ModelPublication publication{};       ///< address 0: none
  std::vector<Address> subscriptions{};

  bool operator==(const Model&) const = default;
};

/// Section 4.2.14; 3 is a command only.
enum class KeyRefreshPhase : std::uint8_t { none = 0, distribution = 1, switched = 2 };

struct NetKey {
  std::uint16_t index = 0;
  Key key{};
  std::optional<Key> new_key{};  ///< during a key refresh
  KeyRefreshPhase phase = KeyRefreshPhase::none;

  bool operator==(const NetKey&) const = default;
};

struct AppKey {
  std::uint16_t index = 0;
  Key key{};
  std::optional<Key> new_key{};  ///< during a key refresh of its network
  std::uint16_t net_index = 0;

  bool operator==(const AppKey&) const = default;
};

struct NodeConfiguration {
  static constexpr std::size_t max_net_keys = 2;
  static constexpr std::size_t max_app_keys = 8;
  static constexpr std::size_t max_groups = 32;  ///< maximum of subscriptions of all models

  std::optional<ProvisioningData> network;  ///< nothing: not provisioned
  Key device_key{};
  std::vector<NetKey> net_keys;
  std::vector<AppKey> app_keys;
  std::vector<Model> models = factory_models();
  std::uint8_t ttl = default_ttl;  ///< of its answers, and of publications that name none
  // Stored without effect:
  std::uint8_t relay = 1;
  std::uint8_t relay_retransmit = 0;
  std::uint8_t secure_network_beacon = 1;
  std::uint8_t network_transmit = 0;

  static std::vector<Model> factory_models();
  /// Makes the node provisioned; the network's key is its first.
  void join(const ProvisioningData& data, const Key& new_device_key);
  Model* find_model(ModelId id);
  const Model* find_model(ModelId id) const;
  NetKey* find_net_key(std::uint16_t index);
  const NetKey* find_net_key(std::uint16_t index) const;
  const AppKey* find_app_key(std::uint16_t index) const;
  /// Returns the network with this key, old or new; null when the node has none.
  const NetKey* network_of(const Key& key) const;
  bool has_net_key(const Key& key) const { return network_of(key) != nullptr; }
  /// Returns the key for sending in the network and with its application keys.
  Key sending_key(const NetKey& net_key) const;
  Key sending_key(const AppKey& app_key) const;

  bool operator==(const NodeConfiguration&) const = default;
};

/// The period of section 4.2.2.2; 0: not periodic.
Duration publish_period(std::uint8_t octet);

}  // namespace slamgw::sim::ble
