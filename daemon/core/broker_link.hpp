// SPDX-License-Identifier: Apache-2.0
// The link to the broker as it is now. Written by App when the MQTT client tells
// of a change; everybody else reads it.
#pragma once

#include <string>

#include "daemon/core/time.hpp"

namespace slamgw {

struct BrokerLink {
  bool is_up = false;
  WallTime since{};   ///< of this state, or of the reason why it is down
  std::string why;    ///< it is down; empty while it is up
  std::string uri{};  ///< of the broker that it is up to; empty while it is down
};

}  // namespace slamgw
