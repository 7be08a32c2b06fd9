// SPDX-License-Identifier: Apache-2.0
// The requests that configure a robot, by its composition data: the application key for its models,
// publication to the gateway for those that speak, groups for those that listen. Only models that
// it has; at least the thesis's (thesis 5.2.1), on/off and health. Called by NodeConfiguration.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/access/config_messages.hpp"

namespace slamgw::ble {

struct ModelElement {
  std::uint16_t element = 0;  ///< unicast address
  ModelId model;
};

/// One request under the node's device key, and how its answer is known.
struct ConfigurationStep {
  std::string what;  ///< for the operator
  Bytes request;     ///< access message
  Opcode answer = 0;
  bool has_status = true;                            ///< the answer's first octet is a status
  Bytes echoed_head = {};                            ///< what comes after the status
  Bytes echoed_tail = {};                            ///< what the answer ends with
  bool is_required = true;                           ///< without it the rest makes no sense
  std::uint8_t also_done = 0;                        ///< a status that means as much as success
  std::optional<ModelElement> lists_groups_of = {};  ///< its answer is this model's groups

  /// True also for an answer that says no.
  bool is_answered_by(const AccessMessage& message) const;
};

struct ConfigurationSettings {
  Key app_key{};
  std::uint16_t destination = 0x0001;  ///< of what the robot publishes: a gateway, or their group
  std::uint8_t ttl = 4;
  std::vector<std::uint16_t> groups;
};

ConfigurationStep composition_step();
ConfigurationStep node_reset_step();
/// What follows the composition data. `address` is the node's.
std::vector<ConfigurationStep> plan_configuration(const ConfigurationSettings& settings,
                                                  std::uint16_t address,
                                                  const Composition& composition);
/// The same when only its publications change.
std::vector<ConfigurationStep> plan_publications(const ConfigurationSettings& settings,
                                                 std::uint16_t address,
                                                 const Composition& composition);
/// What follows the list of groups that a model of the node has: it is left with those of the
/// settings. Groups are taken away one by one, because a robot that runs Nordic's code stops on a
/// failed assertion when Subscription Delete All or Overwrite meets a model with more subscriptions
/// than the robot has subscription lists (all releases). Virtual addresses stay: a list names their
/// hashes only, and they are deleted by their label.
std::vector<ConfigurationStep> plan_groups(const ConfigurationSettings& settings,
                                           const ModelElement& of,
                                           const std::vector<std::uint16_t>& subscribed);

}  // namespace slamgw::ble
