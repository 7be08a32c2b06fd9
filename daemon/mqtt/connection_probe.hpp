// SPDX-License-Identifier: Apache-2.0
// Finds out in words why no connection to the broker came about, by trying its steps again: name,
// TCP, TLS. Paho tells no reasons. Blocks for a few seconds at most: called on PahoLink's lane.
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

/// The addresses of the broker's host as literals, in the resolver's order; empty when the name is
/// not known.
std::vector<std::string> resolve_host(const std::string& host);

}  // namespace slamgw
