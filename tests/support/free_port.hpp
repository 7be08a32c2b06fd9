// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace slamgw::test {

/// A TCP port of loopback that nobody uses, and that no other test process is given as long as this
/// one runs: a broker that is killed finds it free when it starts again.
std::uint16_t free_tcp_port();
/// The same for UDP, on all addresses.
std::uint16_t free_udp_port();

}  // namespace slamgw::test
