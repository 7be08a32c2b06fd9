// SPDX-License-Identifier: Apache-2.0
// The present state of the link to the broker. App writes it when the MQTT client reports a change;
// all other parts only read it.
#pragma once

#include <string>
#include <string_view>

#include "daemon/core/time.hpp"

namespace slamgw {

struct BrokerLink {
  bool is_up = false;
  WallTime since{};        ///< when this state, or this reason for being down, began
  std::string why;         ///< why the link is down; empty while it is up
  std::string uri{};       ///< URI of the connected broker; empty while the link is down
  bool is_silent = false;  ///< the link is up, but the broker has not answered for seconds
};

/// Returns whether `broker.state` of a gateway's status is one of a connected gateway.
inline bool is_broker_there(std::string_view state) { return state == "up" || state == "refusing"; }

}  // namespace slamgw
