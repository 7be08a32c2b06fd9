// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl replay`: publishes a recording to a broker with the recorded timing, for those
// who develop servers without robots.
#pragma once

#include <vector>

#include "ctl/host/recording.hpp"
#include "daemon/mqtt/settings.hpp"

namespace slamgw::ctl {

struct Replayed {
  std::uint64_t published = 0;
  std::uint64_t refused = 0;
  std::string why;  ///< of the last one that was refused
};

/// Returns when the broker has taken the last message. `speed`: 2 is twice as fast. Throws Failure
/// when the broker is not reached, or goes away.
Replayed replay(std::vector<RecordedMessage> messages, BrokerSettings broker, double speed);

}  // namespace slamgw::ctl
