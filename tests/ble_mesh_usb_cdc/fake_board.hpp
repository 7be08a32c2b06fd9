// SPDX-License-Identifier: Apache-2.0
// A serial board with stock firmware, as far as the gateway uses it, written from the protocol's
// description and sharing no code with the daemon (its devices borrow the key exchange). Bytes in,
// bytes out; used on virtual time and behind a pseudo-terminal.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "daemon/core/bytes.hpp"
#include "tests/ble_mesh_usb_cdc/fake_devices.hpp"

namespace slamgw::ble {

class FakeBoard {
 public:
  struct Address {
    std::uint16_t address = 0;
    bool is_subscribed = false;
    int published = 0;  ///< additions minus removals
  };
  struct SentPacket {
    std::uint16_t appkey_handle = 0;
    std::uint16_t source = 0;
    std::uint16_t destination = 0;
    std::uint8_t ttl = 0;
    Bytes payload;
  };

  /// True for the stock board, which is built without storage.
  bool forgets = false;

  // State that survives a restart unless the board forgets.
  std::uint16_t unicast = 0;  ///< 0: not set
  std::uint16_t unicast_count = 1;
  std::vector<std::pair<std::uint16_t, Bytes>> subnets;
  std::vector<std::pair<std::uint16_t, Bytes>> appkeys;
  Bytes new_net_key;  ///< during a key refresh: receives under both, sends under the old key
  Bytes new_app_key;
  std::vector<std::optional<Address>> addresses;  ///< the index is the handle
  std::size_t max_addresses = 32;
  std::uint16_t serial_version = 10;
  std::uint8_t uuid_octet = 0xab;  ///< its UUID has 16 of them

  // Running state.
  bool is_enabled = true;  ///< the stock example starts the mesh itself
  std::uint32_t dropped = 0;
  std::vector<std::uint8_t> commands;  ///< opcodes, in order
  std::vector<SentPacket> sent;
  FakeDevices devices;  ///< in radio range

  // Faults.
  bool is_silent = false;
  std::set<std::uint8_t> ignored;                    ///< commands that get no answer
  std::map<std::uint8_t, std::uint8_t> status_of;    ///< answer with this status instead
  std::optional<std::size_t> ignore_command_number;  ///< counted from 0, once

  /// Takes octets from the host; returns the board's answer.
  Bytes on_bytes(ByteView bytes);
  /// Number of Packet Sends to refuse, as while an earlier segmented message is being sent.
  int busy_sends = 0;

  /// Loses the contents of RAM, as at power-on.
  Bytes restart();
  /// Returns the event for an access message from `source` to the gateway or to a group's handle.
  Bytes message(std::uint16_t source, ByteView payload, std::uint16_t group = 0,
                std::uint16_t key_handle = 0) const;

  std::optional<std::uint16_t> handle_of(std::uint16_t address) const;
  std::size_t count(std::uint8_t opcode) const;
  bool is_mid_packet() const { return !partial_.empty(); }

 private:
  Bytes execute(std::uint8_t opcode, ByteView params);
  Bytes add_key(std::vector<std::pair<std::uint16_t, Bytes>>& keys, std::uint8_t opcode,
                std::uint16_t index, ByteView key);
  Bytes update_key(std::uint8_t opcode, ByteReader params, std::size_t keys, Bytes& new_key) const;
  Bytes list_appkeys(std::uint16_t subnet) const;
  Bytes add_address(std::uint8_t opcode, std::uint16_t address);
  Bytes remove_address(std::uint8_t opcode, std::uint16_t handle);
  Bytes get_address(std::uint16_t handle) const;
  Bytes send_packet(ByteReader params);
  Bytes clear();

  Bytes partial_;
  std::uint32_t token_ = 0;
};

}  // namespace slamgw::ble
