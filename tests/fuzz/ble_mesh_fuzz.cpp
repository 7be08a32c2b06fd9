// SPDX-License-Identifier: Apache-2.0
// Any order of inputs to the BLE mesh, with answers to its Echo so that it gets in step. The input
// is a list of `verb argument octets(argument)`. A machine that drains is due in the future only.
#include <cstdlib>

#include "tests/fuzz/ble_mesh_inputs.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  slamgw::ble::MeshInputs inputs;
  slamgw::ByteReader reader(slamgw::ByteView(data, size));
  while (reader.remaining() >= 2) {
    const std::uint8_t verb = reader.read_u8();
    const std::uint8_t argument = reader.read_u8();
    inputs.apply(verb, argument, reader.read(std::min<std::size_t>(argument, reader.remaining())));
    if (!inputs.is_settled()) std::abort();
  }
  return 0;
}
