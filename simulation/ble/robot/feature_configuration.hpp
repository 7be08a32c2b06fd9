// SPDX-License-Identifier: Apache-2.0
// The part of the configuration server for the node as a whole: default TTL, relay, friend,
// proxy, beacon, network transmissions (Mesh Profile 1.0 sections 4.3.2.1 to 4.3.2.14).
#pragma once

#include "simulation/ble/robot/config_message.hpp"

namespace slamgw::sim::ble {

class FeatureConfiguration {
 public:
  /// `configuration` must outlive this object.
  explicit FeatureConfiguration(NodeConfiguration& configuration) : configuration_(configuration) {}

  /// Returns nothing for messages of other parts.
  std::optional<Answer> on_message(std::uint16_t opcode, ByteView parameters);

 private:
  Answer beacon_get(ByteView parameters);
  Answer beacon_set(ByteView parameters);
  Answer default_ttl_get(ByteView parameters);
  Answer default_ttl_set(ByteView parameters);
  Answer friend_get(ByteView parameters);
  Answer friend_set(ByteView parameters);
  Answer proxy_get(ByteView parameters);
  Answer proxy_set(ByteView parameters);
  Answer relay_get(ByteView parameters);
  Answer relay_set(ByteView parameters);
  Answer network_transmit_get(ByteView parameters);
  Answer network_transmit_set(ByteView parameters);

  NodeConfiguration& configuration_;
};

}  // namespace slamgw::sim::ble
