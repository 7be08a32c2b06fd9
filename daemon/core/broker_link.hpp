// SPDX-License-Identifier: Apache-2.0
// The present state of the link to the broker, and how the broker answers a SUBSCRIBE. App writes
// the state when the MQTT client reports a change; everybody else only reads it.
#pragma once

#include <cstdint>
#include <string>

#include "daemon/core/time.hpp"

namespace slamgw {

struct BrokerLink {
  bool is_up = false;
  WallTime since{};           ///< since when it is in this state, or down for this reason
  std::string why;            ///< why it is down; empty while it is up
  std::string uri{};          ///< of the broker that it is up to; empty while it is down
  bool keeps_session = true;  ///< while it is up: what comes while we are away (MQTT 5)
  bool is_silent = false;     ///< it is up, and the broker has not answered for seconds
};

enum class SubscribeAnswer : std::uint8_t {
  granted,
  refused,            ///< by a reason code
  closes_connection,  ///< the broker closes the connection in place of an answer
};
/// Of one that is not granted: what to do about it.
std::string in_words(const std::string& filter, SubscribeAnswer answer);

}  // namespace slamgw
