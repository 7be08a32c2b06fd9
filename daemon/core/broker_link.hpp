// SPDX-License-Identifier: Apache-2.0
// The present state of the link to the broker. App writes it when the MQTT client reports a change;
// everybody else only reads it.
#pragma once

#include <string>

#include "daemon/core/time.hpp"

namespace slamgw {

struct BrokerLink {
  bool is_up = false;
  WallTime since{};        ///< since when it is in this state, or down for this reason
  std::string why;         ///< why it is down; empty while it is up
  std::string uri{};       ///< of the broker that it is up to; empty while it is down
  bool is_silent = false;  ///< it is up, and the broker has not answered for seconds
};

}  // namespace slamgw
