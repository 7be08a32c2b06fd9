// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/access/vendor_models.hpp"

#include <array>

namespace slamgw::ble {
namespace {

// c5..c8 min_com, c9..cc sensor_update, cd..d0 pos_cmd; then company 0x0059, little-endian.
constexpr Opcode first_opcode = 0xc55900;
constexpr Opcode opcode_step = 0x010000;
constexpr Opcode kinds = 4;

}  // namespace

Opcode opcode_of(VendorMessage message) {
  return first_opcode + opcode_step * (static_cast<Opcode>(message.model) * kinds +
                                       static_cast<Opcode>(message.kind));
}

std::optional<VendorMessage> vendor_message_of(Opcode opcode) {
  if (opcode < first_opcode || (opcode - first_opcode) % opcode_step != 0) return std::nullopt;
  const Opcode place = (opcode - first_opcode) / opcode_step;
  if (place >= vendor_model_count * kinds) return std::nullopt;
  return VendorMessage{static_cast<VendorModel>(place / kinds),
                       static_cast<MessageKind>(place % kinds)};
}

Bytes encode_status(VendorModel model) {
  return encode_access(opcode_of({model, MessageKind::status}), std::array<std::uint8_t, 1>{0});
}

}  // namespace slamgw::ble
