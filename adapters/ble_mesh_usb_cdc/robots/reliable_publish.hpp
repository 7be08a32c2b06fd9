// SPDX-License-Identifier: Apache-2.0
// The timing of Nordic's reliable publish (access_reliable.h): an acknowledged message is repeated
// at iv, 2iv, 4iv, 8iv ... after its first transmission until a STATUS comes back. Robots do it
// towards the gateway, and the gateway towards robots.
#pragma once

#include <cstdint>

#include "adapters/ble_mesh_usb_cdc/access/opcode.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

/// iv = 200 ms + 20 ms for each hop that the TTL allows + 20 ms for each segment if segmented.
inline Duration reliable_interval(std::uint8_t ttl, std::size_t access_bytes) {
  const std::size_t segments = segments_of(access_bytes);
  return std::chrono::milliseconds{200 + 20 * ttl} +
         std::chrono::milliseconds{20} * (segments > 1 ? static_cast<long>(segments) : 0L);
}

}  // namespace slamgw::ble
