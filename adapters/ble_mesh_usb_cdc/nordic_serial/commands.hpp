// SPDX-License-Identifier: Apache-2.0
// The commands of Nordic's serial protocol (API version 10) that the daemon sends, as complete
// frames. Multi-byte numbers are little-endian on the wire, keys most significant octet first. What
// the board answers: events.hpp. Called by Resync, StartUp and BoardLink.
#pragma once

#include <array>
#include <cstdint>

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

enum class CommandOpcode : std::uint8_t {
  echo = 0x02,
  serial_version_get = 0x09,
  housekeeping_get = 0x14,
  uuid_get = 0x54,
  enable = 0x90,
  subnet_add = 0x92,
  subnet_get_all = 0x95,
  appkey_add = 0x97,
  appkey_get_all = 0x9a,
  local_unicast_set = 0x9f,
  local_unicast_get = 0xa0,
  subscription_add = 0xa1,
  publication_add = 0xa4,
  publication_remove = 0xa6,
  address_get = 0xa7,
  address_get_all = 0xa8,
  packet_send = 0xab,
};

using Key = std::array<std::uint8_t, 16>;

/// The secrets of one mesh. Never printed, never in a Notice.
struct MeshKeys {
  Key net_key{};
  Key app_key{};
  bool operator==(const MeshKeys&) const = default;
};

/// One access message to send (0xab).
struct PacketSend {
  std::uint16_t appkey_handle = 0;
  std::uint16_t source = 0;              ///< a local unicast address
  std::uint16_t destination_handle = 0;  ///< from 0xa4
  std::uint8_t ttl = 0;
  ByteView payload;  ///< access message, opcode first; at most `max_send_bytes`
};
inline constexpr std::size_t max_send_bytes = 244;

/// A command that has no parameters.
Bytes encode_command(CommandOpcode opcode);
Bytes encode_echo(ByteView nonce);
Bytes encode_subnet_add(std::uint16_t index, const Key& key);
Bytes encode_appkey_add(std::uint16_t index, std::uint16_t subnet_handle, const Key& key);
Bytes encode_local_unicast_set(std::uint16_t address, std::uint16_t count);
Bytes encode_packet_send(const PacketSend& packet);
/// The commands whose only parameter is a handle, an address or an index.
Bytes encode_command(CommandOpcode opcode, std::uint16_t parameter);

}  // namespace slamgw::ble
