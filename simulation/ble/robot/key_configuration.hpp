// SPDX-License-Identifier: Apache-2.0
// The part of the configuration server for network and application keys and their refresh (Mesh
// Profile 1.0 sections 4.3.2.31 to 4.3.2.44).
#pragma once

#include "simulation/ble/robot/config_message.hpp"

namespace slamgw::sim::ble {

class KeyConfiguration {
 public:
  /// `configuration` must outlive this object.
  explicit KeyConfiguration(NodeConfiguration& configuration) : configuration_(configuration) {}

  /// Returns nothing for messages of other parts.
  std::optional<Answer> on_message(std::uint16_t opcode, ByteView parameters);

 private:
  Answer net_key_add(ByteView parameters);
  Answer net_key_update(ByteView parameters);
  Answer net_key_delete(ByteView parameters);
  Answer net_key_get(ByteView parameters);
  Answer app_key_add(ByteView parameters);
  Answer app_key_update(ByteView parameters);
  Answer app_key_delete(ByteView parameters);
  Answer app_key_get(ByteView parameters);
  Answer phase_get(ByteView parameters);
  Answer phase_set(ByteView parameters);
  Answer identity_get(ByteView parameters);
  Answer identity_set(ByteView parameters);

  ConfigStatus store_net_key(std::uint16_t index, const Key& key);
  ConfigStatus renew_net_key(std::uint16_t index, const Key& key);
  ConfigStatus remove_net_key(std::uint16_t index);
  ConfigStatus store_app_key(const AppKey& key);
  ConfigStatus renew_app_key(std::uint16_t net_index, std::uint16_t index, const Key& key);
  void remove_app_key(std::uint16_t index);
  void finish_refresh(NetKey& net_key);

  NodeConfiguration& configuration_;
};

}  // namespace slamgw::sim::ble
