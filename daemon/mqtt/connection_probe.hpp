// SPDX-License-Identifier: Apache-2.0
// The steps to a broker before MQTT: name, TCP, TLS. For a client library that gives no reasons
// (Paho) they are tried again, to explain why no connection was made. Blocks for a few seconds at
// most: call on the lane of a link.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "daemon/mqtt/settings.hpp"
#include "daemon/mqtt/tls_client.hpp"

namespace slamgw {

struct Reachability {
  bool is_reachable = false;  ///< TCP, and TLS where it is used, work
  std::string text;           ///< for the operator: what fails and what to look at
};
Reachability probe_broker(const BrokerSettings& broker);

/// A broker's addresses and TLS files, looked up for one attempt to connect.
struct WayToBroker {
  std::vector<std::string> addresses{};    ///< literals, in the resolver's order; at least one
  std::shared_ptr<const TlsClient> tls{};  ///< null: without TLS
  std::string problem{};                   ///< why there is no way, for the operator; else empty
};
/// Resolves the broker's name and reads its TLS files.
WayToBroker find_broker(const BrokerSettings& broker);

// Explanations of what the probe finds; clients that find the same by themselves use them, too.
/// `error`: the errno of connect().
std::string explain_no_connection(const BrokerSettings& broker, int error);
/// Explains that the port answers, but not as a broker, or that it closes the connection.
std::string explain_not_a_broker(const BrokerSettings& broker);

}  // namespace slamgw
