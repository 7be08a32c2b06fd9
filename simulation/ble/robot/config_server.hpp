// SPDX-License-Identifier: Apache-2.0
// The configuration server of a robot (Mesh Profile 1.0 section 4.3.2): Composition Data, keys,
// bindings, publications, subscriptions, Node Reset. Works on plain values; Node has decrypted the
// request with the device key and sends the answer.
#pragma once

#include <optional>

#include "simulation/ble/robot/node_configuration.hpp"

namespace slamgw::sim::ble {

/// Section 4.3.5.
enum class ConfigStatus : std::uint8_t {
  success = 0x00,
  invalid_address = 0x01,
  invalid_model = 0x02,
  invalid_app_key_index = 0x03,
  invalid_net_key_index = 0x04,
  insufficient_resources = 0x05,
  key_index_already_stored = 0x06,
  not_a_subscribe_model = 0x08,
  cannot_bind = 0x0d,
};

class ConfigServer {
 public:
  /// The node is provisioned; `configuration` outlives this.
  explicit ConfigServer(NodeConfiguration& configuration) : configuration_(configuration) {}

  struct Result {
    std::optional<Bytes> answer;  ///< nothing for messages that are unknown or of a wrong length
    bool resets_node = false;     ///< once the answer is out
  };
  Result on_message(ByteView message);

 private:
  std::optional<Bytes> composition_get(ByteView parameters) const;
  std::optional<Bytes> app_key_add(ByteView parameters);
  std::optional<Bytes> app_key_delete(ByteView parameters);
  std::optional<Bytes> model_app(ByteView parameters, bool binds);
  std::optional<Bytes> publication_set(ByteView parameters);
  std::optional<Bytes> publication_get(ByteView parameters);
  enum class SubscriptionChange : std::uint8_t { add, remove, overwrite };
  std::optional<Bytes> subscription(ByteView parameters, SubscriptionChange change);
  std::optional<Bytes> subscription_delete_all(ByteView parameters);
  std::optional<Bytes> subscription_get(ByteView parameters, bool is_vendor) const;

  ConfigStatus store_app_key(std::uint16_t net_index, const AppKey& key);
  ConfigStatus bind(Address element, std::uint16_t app_index, ModelId id, bool binds);
  ConfigStatus publish(Address element, const ModelPublication& publication, ModelId id);
  ConfigStatus subscribe(Address element, Address group, ModelId id, SubscriptionChange change);
  ConfigStatus can_subscribe(Address element, ModelId id) const;
  bool is_element(Address address) const { return address == configuration_.network->address; }

  NodeConfiguration& configuration_;
};

}  // namespace slamgw::sim::ble
