// SPDX-License-Identifier: Apache-2.0
// The part of the configuration server for publications of models (Mesh Profile 1.0
// sections 4.3.2.15 to 4.3.2.18).
#pragma once

#include "simulation/ble/firmware.hpp"
#include "simulation/ble/robot/config_message.hpp"

namespace slamgw::sim::ble {

class PublicationConfiguration {
 public:
  /// Both must outlive this object.
  PublicationConfiguration(const Firmware& firmware, NodeConfiguration& configuration)
      : firmware_(firmware), configuration_(configuration) {}

  /// Returns nothing for messages of other parts.
  std::optional<Answer> on_message(std::uint16_t opcode, ByteView parameters);
  /// Returns the assertion that failed on the last message.
  const std::optional<std::string>& failed_assertion() const { return failed_assertion_; }

 private:
  Answer get(ByteView parameters);
  Answer set(ByteView parameters);
  Answer set_virtual(ByteView parameters);
  Answer set(Address element, const ModelPublication& publication, ModelId id);
  ConfigStatus check(Address element, const ModelPublication& publication, ModelId id) const;
  Bytes status(ConfigStatus status, Address element, ModelId id) const;

  const Firmware& firmware_;
  NodeConfiguration& configuration_;
  std::optional<std::string> failed_assertion_;
};

}  // namespace slamgw::sim::ble
