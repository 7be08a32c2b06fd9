// SPDX-License-Identifier: Apache-2.0
// Feeds any octets to the headers for robots: see tests/firmware/any_octets.hpp for the grammar and
// the invariants.
#include "tests/firmware/any_octets.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  slamgw::firmware::SnLife life;
  if (!life.run({data, size}) || !slamgw::firmware::ble_holds({data, size})) __builtin_trap();
  return 0;
}
