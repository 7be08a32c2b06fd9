// SPDX-License-Identifier: Apache-2.0
// Any access message and any mesh.json.
#include <cstdlib>

#include "adapters/ble_mesh_usb_cdc/access/vendor_models.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

using namespace slamgw::ble;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const slamgw::ByteView bytes(data, size);
  (void)decode_node_database(slamgw::as_text(bytes));
  const auto message = decode_access(bytes);
  if (!message.has_value()) return 0;
  const auto vendor = vendor_message_of(message->opcode);
  if (vendor && opcode_of(*vendor) != message->opcode) std::abort();
  return 0;
}
