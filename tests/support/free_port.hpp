// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace slamgw::test {

/// A TCP port on loopback that was free a moment ago.
std::uint16_t free_tcp_port();
std::uint16_t free_udp_port();

}  // namespace slamgw::test
