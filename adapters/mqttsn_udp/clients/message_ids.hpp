// SPDX-License-Identifier: Apache-2.0
// The MsgIds of the gateway's own requests to one client (R90): a space of its own for each.
#pragma once

#include <cstdint>

#include "adapters/mqttsn_udp/clients/delivery.hpp"

namespace slamgw::mqttsn {

/// Never 0, never one that still awaits its answer.
std::uint16_t next_message_id(Delivery& delivery);

}  // namespace slamgw::mqttsn
