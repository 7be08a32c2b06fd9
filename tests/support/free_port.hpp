// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace slamgw::test {

/// Returns an unused TCP port of loopback. No other test process gets it while this one runs, so a
/// killed broker can use it again.
std::uint16_t free_tcp_port();
/// Returns such a UDP port, unused on all addresses.
std::uint16_t free_udp_port();

}  // namespace slamgw::test
