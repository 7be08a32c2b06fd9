// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"

#include "adapters/ble_mesh_usb_cdc/nordic/frame.hpp"

namespace slamgw::ble {
namespace {

Bytes encode(CommandOpcode opcode, ByteView params) {
  return encode_frame(static_cast<std::uint8_t>(opcode), params);
}

Bytes encode(CommandOpcode opcode, const ByteWriter& params) {
  return encode(opcode, params.bytes());
}

}  // namespace

Bytes encode_command(CommandOpcode opcode) { return encode(opcode, ByteWriter{}); }

Bytes encode_command(CommandOpcode opcode, std::uint16_t parameter) {
  return encode(opcode, ByteWriter{}.write_u16_le(parameter));
}

Bytes encode_echo(ByteView nonce) { return encode(CommandOpcode::echo, nonce); }

Bytes encode_subnet_add(std::uint16_t index, const Key& key) {
  return encode(CommandOpcode::subnet_add, ByteWriter{}.write_u16_le(index).write(key));
}

Bytes encode_appkey_add(std::uint16_t index, std::uint16_t subnet_handle, const Key& key) {
  return encode(CommandOpcode::appkey_add,
                ByteWriter{}.write_u16_le(index).write_u16_le(subnet_handle).write(key));
}

Bytes encode_local_unicast_set(std::uint16_t address, std::uint16_t count) {
  return encode(CommandOpcode::local_unicast_set,
                ByteWriter{}.write_u16_le(address).write_u16_le(count));
}

std::string_view sdk_releases(SerialVersion version) {
  switch (version) {
    case SerialVersion::sdk_1_0: return "1.0";
    case SerialVersion::sdk_2_0: return "2.0 or 2.1";
    case SerialVersion::sdk_2_2: return "2.2";
    case SerialVersion::sdk_3_0: return "3.0";
    case SerialVersion::sdk_3_1: return "3.1 to 5.0";
  }
  return {};
}

std::size_t send_limit(SerialVersion version) {
  // The packets of 1.0 and 2.0 are short; 2.1 has the same number as 2.0.
  return version <= SerialVersion::sdk_2_0 ? 88 : 244;
}

Bytes encode_packet_send(const PacketSend& packet, SerialVersion version) {
  ByteWriter params;
  params.write_u16_le(packet.appkey_handle)
      .write_u16_le(packet.source)
      .write_u16_le(packet.destination_handle)
      .write_u8(packet.ttl)
      .write_u8(0);  // segmented only when the size asks for it; in 1.0: "reliable", no
  if (version >= SerialVersion::sdk_2_0) params.write_u8(0);  // 32-bit TransMIC
  if (version >= SerialVersion::sdk_3_0) params.write_u8(0);  // master credentials, not friendship
  return encode(CommandOpcode::packet_send, params.write(packet.payload));
}

Bytes encode_provision(const ProvisionCommand& command) {
  ByteWriter params;
  params.write_u8(command.context)
      .write(command.uuid)
      .write(command.net_key)
      .write_u16_le(0)  // network key index
      .write_u32_le(command.iv_index)
      .write_u16_le(command.address)
      .write_u8(0)                                                    // no IV update in progress
      .write_u8(0);                                                   // no key refresh in progress
  if (command.version >= SerialVersion::sdk_3_0) params.write_u8(0);  // no attention signal
  return encode(CommandOpcode::provision, params);
}

Bytes encode_keypair_set(const KeyPair& pair) {
  return encode(CommandOpcode::keypair_set,
                ByteWriter{}.write(pair.private_key).write(pair.public_key));
}

Bytes encode_capabilities_set() {
  return encode(CommandOpcode::capabilities_set, ByteWriter{}.write_u8(1).write(Bytes(8, 0)));
}

Bytes encode_oob_use(std::uint8_t context, OobMethod method) {
  // Static data is as long as a key; only that size is taken.
  const std::uint8_t size = method == OobMethod::static_data ? sizeof(Key) : 0;
  ByteWriter params;
  params.write_u8(context).write_u8(static_cast<std::uint8_t>(method)).write_u8(0).write_u8(size);
  return encode(CommandOpcode::oob_use, params);
}

Bytes encode_auth_data(std::uint8_t context, const Key& static_oob) {
  return encode(CommandOpcode::auth_data, ByteWriter{}.write_u8(context).write(static_oob));
}

Bytes encode_ecdh_secret(std::uint8_t context, const SharedSecret& secret) {
  return encode(CommandOpcode::ecdh_secret, ByteWriter{}.write_u8(context).write(secret));
}

Bytes encode_devkey_add(std::uint16_t owner, std::uint16_t subnet_handle, const Key& key) {
  return encode(CommandOpcode::devkey_add,
                ByteWriter{}.write_u16_le(owner).write_u16_le(subnet_handle).write(key));
}

}  // namespace slamgw::ble
