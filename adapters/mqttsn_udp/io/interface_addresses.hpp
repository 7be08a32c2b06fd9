// SPDX-License-Identifier: Apache-2.0
// Which interfaces there are, and from which of their addresses an answer to a multicast request
// should leave (R16). Reads the system's tables; the choice itself is a pure function.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

namespace slamgw::mqttsn {

bool is_multicast(const IpAddress& address);
/// An RLOC or ALOC (interface identifier 0000:00ff:fe00:xxxx): OpenThread hands nothing that is
/// sent to it to the host.
bool is_thread_locator(const IpAddress& address);
bool is_link_local(const IpAddress& address);

/// The best source to answer `from` (not a locator; link-local only to link-local), nothing when
/// the kernel should choose.
std::optional<IpAddress> choose_source(const std::vector<IpAddress>& candidates,
                                       const IpAddress& from);

/// 0: there is no such interface (now).
std::uint32_t interface_index(const std::string& name);
std::vector<IpAddress> addresses_of_interface(std::uint32_t interface);
/// Indices of the interfaces that are up and know multicast, and of loopback; only `name` unless it
/// is empty.
std::vector<std::uint32_t> multicast_interfaces(const std::string& name);

}  // namespace slamgw::mqttsn
