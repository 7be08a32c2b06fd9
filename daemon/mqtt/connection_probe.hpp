// SPDX-License-Identifier: Apache-2.0
// Finds out in words why no connection to the broker came about, by trying its steps again: name,
// TCP, TLS. Paho tells no reasons. Blocks for a few seconds at most: called on PahoSession's lane.
#pragma once

#include <string>
#include <vector>

#include "daemon/mqtt/settings.hpp"

namespace slamgw {

/// A sentence for the operator: what fails and what to look at.
std::string explain_unreachable(const BrokerSettings& broker);

/// The addresses of the broker's host as literals, in the resolver's order; empty when the name is
/// not known.
std::vector<std::string> resolve_host(const std::string& host);

}  // namespace slamgw
