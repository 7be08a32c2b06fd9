// SPDX-License-Identifier: Apache-2.0
// The network interfaces that the system has now, and their addresses.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

namespace slamgw::mqttsn {

struct NetworkInterface {
  std::uint32_t index = 0;  ///< changes each time that the interface is made again
  std::string name;
  bool is_loopback = false;
  bool takes_multicast = false;  ///< it is up, and knows multicast or is loopback
  bool has_carrier = false;      ///< datagrams that are sent there are not lost at once
  std::vector<IpAddress> addresses;
};

/// Asks the kernel. Returns an empty list when it does not answer.
std::vector<NetworkInterface> read_network_interfaces();

}  // namespace slamgw::mqttsn
