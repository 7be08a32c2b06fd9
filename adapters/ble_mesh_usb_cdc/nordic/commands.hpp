// SPDX-License-Identifier: Apache-2.0
// The commands of Nordic's serial protocol (versions 5 to 10) that the daemon sends, as complete
// frames. Multi-byte numbers are little-endian on the wire, keys most significant octet first. What
// the board answers: events.hpp. Called by Resync, StartUp, BoardLink and ProvisioningSession.
#pragma once

#include <string_view>

#include "adapters/ble_mesh_usb_cdc/radio.hpp"

namespace slamgw::ble {

enum class CommandOpcode : std::uint8_t {
  echo = 0x02,
  serial_version_get = 0x09,
  radio_reset = 0x0e,  ///< no response: the board restarts and says so (0x81)
  housekeeping_get = 0x14,
  uuid_get = 0x54,
  scan_start = 0x61,
  scan_stop = 0x62,
  provision = 0x63,
  oob_use = 0x66,
  auth_data = 0x67,
  ecdh_secret = 0x68,
  keypair_set = 0x69,
  capabilities_set = 0x6a,
  enable = 0x90,
  subnet_add = 0x92,
  subnet_get_all = 0x95,
  appkey_add = 0x97,
  appkey_get_all = 0x9a,
  appkey_count_max_get = 0x9b,
  devkey_add = 0x9c,
  devkey_delete = 0x9d,
  devkey_count_max_get = 0x9e,
  local_unicast_set = 0x9f,
  local_unicast_get = 0xa0,
  subscription_add = 0xa1,
  publication_add = 0xa4,
  publication_remove = 0xa6,
  address_get = 0xa7,
  address_get_all = 0xa8,
  packet_send = 0xab,
  state_clear = 0xac,  ///< also resets the sequence numbers: on an operator's word only
};

/// The two coordinates of a point on P-256, X before Y, each most significant octet first.
using PublicKey = std::array<std::uint8_t, 64>;
using SharedSecret = std::array<std::uint8_t, 32>;
struct KeyPair {
  std::array<std::uint8_t, 32> private_key{};
  PublicKey public_key{};
};

/// One access message to send (0xab).
struct PacketSend {
  std::uint16_t appkey_handle = 0;
  std::uint16_t source = 0;              ///< a local unicast address
  std::uint16_t destination_handle = 0;  ///< from 0xa4
  std::uint8_t ttl = 0;
  ByteView payload;  ///< access message, opcode first; at most `send_limit`
};

/// What the firmware answers to 0x09. Of what the daemon sends, Packet Send and Provision differ
/// between the versions: a Packet Send that is too long puts its last octets before each message
/// on air.
enum class SerialVersion : std::uint16_t {
  sdk_1_0 = 5,   ///< nRF5 SDK for Mesh 1.0.x
  sdk_2_0 = 6,   ///< 2.0.x, 2.1.x
  sdk_2_2 = 8,   ///< 2.2.0
  sdk_3_0 = 9,   ///< 3.0.0
  sdk_3_1 = 10,  ///< 3.1.0 to 5.0.0
};
/// The releases of that version in words, such as "2.2"; empty for numbers that none has.
std::string_view sdk_releases(SerialVersion version);
/// Longest access message that every firmware of this version sends: 244 octets, old ones less.
std::size_t send_limit(SerialVersion version);

/// A command that has no parameters.
Bytes encode_command(CommandOpcode opcode);
Bytes encode_echo(ByteView nonce);
Bytes encode_subnet_add(std::uint16_t index, const Key& key);
Bytes encode_appkey_add(std::uint16_t index, std::uint16_t subnet_handle, const Key& key);
Bytes encode_local_unicast_set(std::uint16_t address, std::uint16_t count);
Bytes encode_packet_send(const PacketSend& packet, SerialVersion version);
/// The commands whose only parameter is a handle, an address or an index.
Bytes encode_command(CommandOpcode opcode, std::uint16_t parameter);

/// 0x63. Key index 0, no IV update and no key refresh in progress, no attention signal.
struct ProvisionCommand {
  std::uint8_t context = 0;  ///< one of the board's two provisioning links
  Uuid uuid{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;  ///< of the device's first element
  SerialVersion version = SerialVersion::sdk_3_1;
};

enum class OobMethod : std::uint8_t { none = 0, static_data = 1 };

Bytes encode_provision(const ProvisionCommand& command);
Bytes encode_keypair_set(const KeyPair& pair);
/// What the board itself can do: one element, no OOB.
Bytes encode_capabilities_set();
Bytes encode_oob_use(std::uint8_t context, OobMethod method);
Bytes encode_auth_data(std::uint8_t context, const Key& static_oob);
Bytes encode_ecdh_secret(std::uint8_t context, const SharedSecret& secret);
Bytes encode_devkey_add(std::uint16_t owner, std::uint16_t subnet_handle, const Key& key);

}  // namespace slamgw::ble
