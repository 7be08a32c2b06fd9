// SPDX-License-Identifier: Apache-2.0
// What has to be said to the socket of the broker's connection, which Paho keeps to itself.
#pragma once

#include <cstdint>

namespace slamgw {

/// Sets TCP_NODELAY on this process's connections to that port. Paho does not: with Nagle's
/// algorithm a message waits until the broker has acknowledged the TCP segment before, at QoS 0 for
/// up to 40 ms. Any thread.
void send_without_delay(std::uint16_t broker_port);

}  // namespace slamgw
