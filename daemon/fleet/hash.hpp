// SPDX-License-Identifier: Apache-2.0
// A hash that is the same in every version and on every machine: gateways compare its results.
#pragma once

#include <cstdint>
#include <string_view>

namespace slamgw::fleet {

/// FNV-1a, 64 bits; `seed` continues an earlier hash.
constexpr std::uint64_t fnv1a(std::string_view text, std::uint64_t seed = 14695981039346656037ULL) {
  for (const char c : text) seed = (seed ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return seed;
}

}  // namespace slamgw::fleet
