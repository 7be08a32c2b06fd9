// SPDX-License-Identifier: Apache-2.0
// What one gateway hands to the next for a robot, as octets: a big-endian age in milliseconds (4),
// the QoS (1), the length of the topic (2), the topic, and the payload. Pure.
#pragma once

#include <optional>

#include "daemon/core/messages.hpp"

namespace slamgw::sessions {

Bytes encode_waiting(const WaitingMessage& waiting);
/// `waited` of the message is its age. Nothing when the octets are no such message.
std::optional<BrokerMessage> decode_waiting(ByteView octets);

}  // namespace slamgw::sessions
