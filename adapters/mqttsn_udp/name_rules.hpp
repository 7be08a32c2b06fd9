// SPDX-License-Identifier: Apache-2.0
// What clients and topics may be called.
#pragma once

#include "adapters/mqttsn_udp/clients/predefined_topics.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {

/// The first two may change (SnGateway::reconfigure).
struct NameRules {
  TopicPolicy policy;
  RobotNames names;
  const PredefinedTopics predefined;
};

}  // namespace slamgw::mqttsn
