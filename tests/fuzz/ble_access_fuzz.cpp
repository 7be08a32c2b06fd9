// SPDX-License-Identifier: Apache-2.0
// Feeds any octets as access message, mesh.json, and mesh to import.
#include <cstdlib>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"

using namespace slamgw::ble;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const slamgw::ByteView bytes(data, size);
  const auto mesh = decode_node_database(slamgw::as_text(bytes));
  if (mesh.has_value() && !decode_node_database(encode_node_database(*mesh)).has_value())
    std::abort();
  const auto imported = decode_imported_mesh(slamgw::as_text(bytes));
  if (imported.has_value()) (void)merge_imported_mesh({}, *imported, 1);
  const auto message = decode_access(bytes);
  if (!message.has_value()) return 0;
  const auto vendor = vendor_message_of(message->opcode);
  if (vendor && opcode_of(*vendor) != message->opcode) std::abort();
  return 0;
}
