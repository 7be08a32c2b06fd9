// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/access/opcode.hpp"

namespace slamgw::ble {
namespace {

constexpr std::uint8_t reserved_opcode = 0x7f;
constexpr std::size_t max_unsegmented_bytes = 11;
constexpr std::size_t segment_bytes = 12;
constexpr std::size_t transmic_bytes = 4;

std::size_t opcode_size(std::uint8_t first) {
  if (first < 0x80) return 1;
  return first < 0xc0 ? 2 : 3;
}

}  // namespace

Result<AccessMessage, DecodeError> decode_access(ByteView payload) {
  if (payload.empty()) return DecodeError::too_short;
  if (payload.front() == reserved_opcode) return DecodeError::bad_value;
  const std::size_t size = opcode_size(payload.front());
  if (payload.size() < size) return DecodeError::too_short;
  AccessMessage message;
  for (const std::uint8_t octet : payload.first(size)) message.opcode = message.opcode << 8 | octet;
  message.params = payload.subspan(size);
  return message;
}

Bytes encode_access(Opcode opcode, ByteView params) {
  ByteWriter payload;
  if (opcode > 0xffff) payload.write_u8(static_cast<std::uint8_t>(opcode >> 16));
  if (opcode > 0xff) payload.write_u8(static_cast<std::uint8_t>(opcode >> 8));
  payload.write_u8(static_cast<std::uint8_t>(opcode)).write(params);
  return payload.take();
}

std::size_t segments_of(std::size_t access_bytes) {
  if (access_bytes <= max_unsegmented_bytes) return 1;
  return (access_bytes + transmic_bytes + segment_bytes - 1) / segment_bytes;
}

}  // namespace slamgw::ble
