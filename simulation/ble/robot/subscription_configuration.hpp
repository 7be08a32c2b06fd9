// SPDX-License-Identifier: Apache-2.0
// The part of the configuration server for subscriptions of models (Mesh Profile 1.0
// sections 4.3.2.19 to 4.3.2.30).
#pragma once

#include "simulation/ble/robot/config_message.hpp"

namespace slamgw::sim::ble {

class SubscriptionConfiguration {
 public:
  /// `configuration` must outlive this object.
  explicit SubscriptionConfiguration(NodeConfiguration& configuration)
      : configuration_(configuration) {}

  /// Returns nothing for messages of other parts.
  std::optional<Answer> on_message(std::uint16_t opcode, ByteView parameters);
  /// Returns the assertion that failed on the last message.
  const std::optional<std::string>& failed_assertion() const { return failed_assertion_; }

 private:
  enum class Change : std::uint8_t { add, remove, overwrite };

  Answer add(ByteView parameters) { return change(parameters, Change::add); }
  Answer remove(ByteView parameters) { return change(parameters, Change::remove); }
  Answer overwrite(ByteView parameters) { return change(parameters, Change::overwrite); }
  Answer add_virtual(ByteView parameters) { return change_virtual(parameters, Change::add); }
  Answer remove_virtual(ByteView parameters) { return change_virtual(parameters, Change::remove); }
  Answer overwrite_virtual(ByteView parameters) {
    return change_virtual(parameters, Change::overwrite);
  }
  Answer remove_all(ByteView parameters);
  Answer sig_list(ByteView parameters);
  Answer vendor_list(ByteView parameters);

  Answer change(ByteView parameters, Change change);
  Answer change_virtual(ByteView parameters, Change change);
  ConfigStatus apply(Address element, Address group, ModelId id, Change change);
  ConfigStatus can_subscribe(Address element, ModelId id) const;
  bool clear(Model& model);
  bool has_room_for(Address group) const;
  Answer status(ConfigStatus status, Address element, Address group, ModelId id) const;
  Bytes list(std::uint16_t opcode, ByteView parameters, ModelId id) const;

  NodeConfiguration& configuration_;
  std::optional<std::string> failed_assertion_;
};

}  // namespace slamgw::sim::ble
