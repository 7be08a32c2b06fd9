// SPDX-License-Identifier: Apache-2.0
// MQTT-SN messages as text, for comparing and reading in tests.
#pragma once

#include <string>

#include "adapters/mqttsn_udp/protocol/packet.hpp"

namespace slamgw::mqttsn {

/// `CONNECT will=0 clean=1 protocol=1 duration=60 client=r1`
std::string describe(const Packet& packet);
/// Describes octets. A forwarder's header becomes `fwd(<node id in hex>,<radius>)`. Returns
/// `invalid` for octets that are not a message.
std::string describe_octets(ByteView octets);

/// "03 02 68 69", spaces optional.
Bytes hex(std::string_view text);

}  // namespace slamgw::mqttsn
