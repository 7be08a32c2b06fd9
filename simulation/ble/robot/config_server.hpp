// SPDX-License-Identifier: Apache-2.0
// The configuration server of a robot (Mesh Profile 1.0 section 4.3.2), as Nordic's firmware has
// it: Composition Data, Node Reset, and parts for everything else. Works on plain values; Node has
// decrypted the request with the device key and sends the answer.
#pragma once

#include <optional>
#include <string>

#include "simulation/ble/robot/binding_configuration.hpp"
#include "simulation/ble/robot/feature_configuration.hpp"
#include "simulation/ble/robot/key_configuration.hpp"
#include "simulation/ble/robot/publication_configuration.hpp"
#include "simulation/ble/robot/subscription_configuration.hpp"

namespace slamgw::sim::ble {

class ConfigServer {
 public:
  /// The node must be provisioned; both must outlive this object.
  ConfigServer(const Firmware& firmware, NodeConfiguration& configuration);

  struct Result {
    Answer answer;
    bool resets_node = false;  ///< after the answer is sent
    /// The failed assertion of the firmware: the robot does not answer, and stops.
    std::optional<std::string> failed_assertion{};
  };
  /// To be called once.
  Result on_message(ByteView message);

 private:
  std::optional<Answer> answer_to(std::uint16_t opcode, ByteView parameters);
  Answer composition_get(ByteView parameters) const;

  NodeConfiguration& configuration_;
  KeyConfiguration keys_;
  FeatureConfiguration features_;
  BindingConfiguration bindings_;
  PublicationConfiguration publications_;
  SubscriptionConfiguration subscriptions_;
};

}  // namespace slamgw::sim::ble
