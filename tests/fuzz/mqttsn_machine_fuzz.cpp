// SPDX-License-Identifier: Apache-2.0
// Feeds any octets as inputs to the MQTT-SN gateway: see tests/mqttsn_udp/fuzz_life.hpp for the
// grammar and the invariants.
#include "tests/mqttsn_udp/fuzz_life.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  slamgw::mqttsn::FuzzLife life;
  if (!life.run({data, size})) __builtin_trap();
  return 0;
}
