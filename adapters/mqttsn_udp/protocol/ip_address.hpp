// SPDX-License-Identifier: Apache-2.0
// IP addresses as plain values, what kinds there are, and which of ours a message should leave from
// (R16). IPv4 addresses are IPv4-mapped (::ffff:a.b.c.d). Pure functions.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

namespace slamgw::mqttsn {

/// In network byte order. All zero stands for no particular address.
using IpAddress = std::array<std::uint8_t, 16>;

bool is_ipv4(const IpAddress& address);
/// IPv4's broadcast to everybody included.
bool is_multicast(const IpAddress& address);
bool is_link_local(const IpAddress& address);
/// An RLOC or ALOC (interface identifier 0000:00ff:fe00:xxxx): routing changes it, and OpenThread
/// hands nothing that is sent to it to the host.
bool is_thread_locator(const IpAddress& address);

/// Which of an interface's addresses a message to `to` (unicast or multicast) should leave from:
/// never a locator, link-local only towards link-local scope, then the longest common prefix; for a
/// multicast, Thread's mesh-local EID, the one address that every robot can reach, before others.
/// All zero: the kernel may choose. Nothing: it would have to choose a locator.
std::optional<IpAddress> choose_source(const std::vector<IpAddress>& candidates,
                                       const IpAddress& to);

}  // namespace slamgw::mqttsn
