// SPDX-License-Identifier: Apache-2.0
// Counts the allocations of this program: operator new is replaced (allocations.cpp).
#pragma once

#include <cstdint>

namespace slamgw::bench {

/// Since the program began.
std::uint64_t allocations();
/// Octets in use now, as the C library counts them.
std::uint64_t octets_in_use();

}  // namespace slamgw::bench
