// SPDX-License-Identifier: Apache-2.0
// What SnGateway leaves to be done.
#pragma once

#include <variant>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw::mqttsn {

struct SendDatagram {
  LocalAddress from;
  Endpoint to;
  Bytes bytes;
};
/// To the configured multicast group.
struct SendMulticast {
  Bytes bytes;
  std::uint32_t interface = 0;  ///< index; 0: on every interface
};

using Action = std::variant<SendDatagram, SendMulticast, MeshEvent>;

}  // namespace slamgw::mqttsn
