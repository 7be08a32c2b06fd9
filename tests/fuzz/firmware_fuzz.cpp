// SPDX-License-Identifier: Apache-2.0
// Any octets for the headers that robots use: see tests/firmware/any_octets.hpp for the grammar and
// what must hold.
#include "tests/firmware/any_octets.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  slamgw::firmware::SnLife life;
  if (!life.run({data, size}) || !slamgw::firmware::ble_holds({data, size})) __builtin_trap();
  return 0;
}
