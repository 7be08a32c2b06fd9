// SPDX-License-Identifier: Apache-2.0
// What a robot has to be told, from what it says it has: the application key for its models,
// publication to the gateway for those that speak, groups for those that listen. Only models that
// it has; at least the thesis's (thesis 5.2.1), on/off and health. Called by NodeConfiguration.
#pragma once

#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/access/config_messages.hpp"

namespace slamgw::ble {

/// One request under the node's device key, and how its answer is known.
struct ConfigurationStep {
  std::string what;  ///< for the operator
  Bytes request;     ///< access message
  Opcode answer = 0;
  bool has_status = true;      ///< the answer's first octet is a status
  Bytes echoed_head;           ///< what comes after the status
  Bytes echoed_tail;           ///< what the answer ends with
  bool is_required = true;     ///< without it the rest makes no sense
  Bytes when_refused = {};     ///< to be asked for then, with the same answer; may be empty
  std::uint8_t also_done = 0;  ///< a status that means as much as success

  /// True also for an answer that says no.
  bool is_answered_by(const AccessMessage& message) const;
};

struct ConfigurationSettings {
  Key app_key{};
  std::uint16_t gateway_address = 0x0001;
  std::uint8_t ttl = 4;
  std::vector<std::uint16_t> groups;
};

ConfigurationStep composition_step();
ConfigurationStep node_reset_step();
/// What follows the composition data. `address` is the node's.
std::vector<ConfigurationStep> plan_configuration(const ConfigurationSettings& settings,
                                                  std::uint16_t address,
                                                  const Composition& composition);

}  // namespace slamgw::ble
