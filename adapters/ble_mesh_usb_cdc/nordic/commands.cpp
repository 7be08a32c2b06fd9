// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"

#include "adapters/ble_mesh_usb_cdc/nordic/frame.hpp"

namespace slamgw::ble {
namespace {

Bytes encode(CommandOpcode opcode, ByteView params) {
  return encode_frame(static_cast<std::uint8_t>(opcode), params);
}

}  // namespace

Bytes encode_command(CommandOpcode opcode) { return encode(opcode, {}); }

Bytes encode_command(CommandOpcode opcode, std::uint16_t parameter) {
  return encode(opcode, ByteWriter{}.write_u16_le(parameter).bytes());
}

Bytes encode_echo(ByteView nonce) { return encode(CommandOpcode::echo, nonce); }

Bytes encode_subnet_add(std::uint16_t index, const Key& key) {
  return encode(CommandOpcode::subnet_add, ByteWriter{}.write_u16_le(index).write(key).bytes());
}

Bytes encode_appkey_add(std::uint16_t index, std::uint16_t subnet_handle, const Key& key) {
  return encode(CommandOpcode::appkey_add,
                ByteWriter{}.write_u16_le(index).write_u16_le(subnet_handle).write(key).bytes());
}

Bytes encode_local_unicast_set(std::uint16_t address, std::uint16_t count) {
  return encode(CommandOpcode::local_unicast_set,
                ByteWriter{}.write_u16_le(address).write_u16_le(count).bytes());
}

Bytes encode_packet_send(const PacketSend& packet) {
  ByteWriter params;
  params.write_u16_le(packet.appkey_handle)
      .write_u16_le(packet.source)
      .write_u16_le(packet.destination_handle)
      .write_u8(packet.ttl)
      .write_u8(0)   // segmented only when the size asks for it
      .write_u8(0)   // 32-bit TransMIC
      .write_u8(0);  // master credentials, not friendship
  return encode(CommandOpcode::packet_send, params.write(packet.payload).bytes());
}

}  // namespace slamgw::ble
