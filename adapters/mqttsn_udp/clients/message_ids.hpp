// SPDX-License-Identifier: Apache-2.0
// The MsgIds of the gateway's own requests to one client (R90): a space of its own for each.
#pragma once

#include <cstdint>
#include <functional>

#include "adapters/mqttsn_udp/clients/delivery.hpp"

namespace slamgw::mqttsn {

/// Unforeseeable numbers.
using RandomSource = std::function<std::uint16_t()>;

/// The next MsgIds follow an unforeseeable one: an answer to them shows that the client receives.
void restart_message_ids(Delivery& delivery, std::uint16_t random);
/// Whether this MsgId was drawn since restart_message_ids().
bool is_since_restart(const Delivery& delivery, std::uint16_t msg_id);

/// Never 0, never one that still awaits its answer.
std::uint16_t next_message_id(Delivery& delivery);

}  // namespace slamgw::mqttsn
