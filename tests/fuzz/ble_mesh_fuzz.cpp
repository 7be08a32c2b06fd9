// SPDX-License-Identifier: Apache-2.0
// Feeds inputs in any order to the BLE mesh, and answers its Echo so that it synchronizes. The data
// is a list of `verb argument octets(argument)`. Aborts when an action stays overdue.
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
