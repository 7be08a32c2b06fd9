// SPDX-License-Identifier: Apache-2.0
// The steps to a broker before MQTT: name, TCP, TLS. For a client that tells no reasons (Paho) they
// are tried again to find out in words why no connection came about. Blocks for a few seconds at
// most: called on the lane of a link.
#pragma once

#include <string>
#include <vector>

#include "daemon/mqtt/settings.hpp"

namespace slamgw {

struct Reachability {
  bool is_reachable = false;  ///< TCP, and TLS where it is used, work
  std::string text;           ///< for the operator: what fails and what to look at
};
Reachability probe_broker(const BrokerSettings& broker);

struct HostAddresses {
  std::vector<std::string> literals;  ///< in the resolver's order
  std::string problem;                ///< why there is none, for the operator
};
HostAddresses resolve_host(const BrokerSettings& broker);

// Words for what the probe finds; a client that sees it by itself uses the same.
/// `error`: of connect().
std::string explain_no_connection(const BrokerSettings& broker, int error);
/// The port answers, but not as a broker, or it closes the connection.
std::string explain_stranger(const BrokerSettings& broker);

}  // namespace slamgw
