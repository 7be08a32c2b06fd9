// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_commands.hpp"

#include "adapters/ble_mesh_usb_cdc/nordic/frame.hpp"

namespace slamgw::ble {
namespace {

Bytes encode(CommandOpcode opcode, const ByteWriter& params) {
  return encode_frame(static_cast<std::uint8_t>(opcode), params.bytes());
}

}  // namespace

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
