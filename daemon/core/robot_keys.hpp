// SPDX-License-Identifier: Apache-2.0
// The pre-shared keys of robots, by the identity that DTLS proves: the robot's MQTT-SN client id.
#pragma once

#include <map>
#include <set>
#include <string>

#include "daemon/core/bytes.hpp"

namespace slamgw {

using RobotKeys = std::map<std::string, Bytes, std::less<>>;
using Identities = std::set<std::string, std::less<>>;

inline Identities identities_of(const RobotKeys& keys) {
  Identities identities;
  for (const auto& key : keys) identities.insert(key.first);
  return identities;
}

}  // namespace slamgw
