// SPDX-License-Identifier: Apache-2.0
// Which network interfaces the system has just now, and their addresses.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

namespace slamgw::mqttsn {

struct NetworkInterface {
  std::uint32_t index = 0;  ///< another one each time that the interface is made
  std::string name;
  bool is_loopback = false;
  bool takes_multicast = false;  ///< it is up, and knows multicast or is loopback
  bool has_carrier = false;      ///< what is sent there is not lost at once
  std::vector<IpAddress> addresses;
};

/// Asks the kernel. Empty when it does not answer.
std::vector<NetworkInterface> read_network_interfaces();

}  // namespace slamgw::mqttsn
