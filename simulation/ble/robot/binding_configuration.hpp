// SPDX-License-Identifier: Apache-2.0
// The part of the configuration server that binds application keys to models (Mesh Profile 1.0
// sections 4.3.2.45 to 4.3.2.51).
#pragma once

#include "simulation/ble/robot/config_message.hpp"

namespace slamgw::sim::ble {

class BindingConfiguration {
 public:
  /// `configuration` must outlive this object.
  explicit BindingConfiguration(NodeConfiguration& configuration) : configuration_(configuration) {}

  /// Returns nothing for messages of other parts.
  std::optional<Answer> on_message(std::uint16_t opcode, ByteView parameters);

 private:
  Answer bind(ByteView parameters) { return change(parameters, true); }
  Answer unbind(ByteView parameters) { return change(parameters, false); }
  Answer change(ByteView parameters, bool binds);
  ConfigStatus change(Address element, std::uint16_t app_index, ModelId id, bool binds);
  Answer sig_list(ByteView parameters);
  Answer vendor_list(ByteView parameters);
  Bytes list(std::uint16_t opcode, ByteView parameters, ModelId id) const;

  NodeConfiguration& configuration_;
};

}  // namespace slamgw::sim::ble
