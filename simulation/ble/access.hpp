// SPDX-License-Identifier: Apache-2.0
// Bluetooth Mesh as the robots and the board share it: addresses, the access messages of robots,
// and the durations of messages (Nordic's nRF5 SDK for Mesh 3.1.0). Pure values.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "simulation/bytes.hpp"
#include "simulation/time.hpp"

namespace slamgw::sim::ble {

using Address = std::uint16_t;
using Key = std::array<std::uint8_t, 16>;

constexpr Address first_robot = 0x0100;  ///< robot n has 0x0100 + n - 1 until provisioned otherwise
constexpr Address min_com_group = 0xc002;
constexpr Address sensor_update_group = 0xc003;
constexpr Address pos_cmd_group = 0xc004;
constexpr Address relay_group = 0xc100;  ///< where gateways relay updates of other meshes
constexpr Address all_proxies = 0xfffc;
constexpr Address all_nodes = 0xffff;
constexpr std::uint8_t default_ttl = 4;

constexpr bool is_unicast(Address address) { return address >= 0x0001 && address <= 0x7fff; }
constexpr bool is_group(Address address) { return address >= 0xc000; }

/// Vendor opcodes of the thesis (company 0x0059) and of Nordic's Simple OnOff; the octet before
/// `59 00`.
enum class Vendor : std::uint8_t {
  simple_on_off_set = 0xc1,
  simple_on_off_get = 0xc2,
  simple_on_off_set_unreliable = 0xc3,
  simple_on_off_status = 0xc4,
  min_com_set = 0xc5,
  min_com_get = 0xc6,
  min_com_set_unreliable = 0xc7,
  min_com_status = 0xc8,
  sensor_update_set = 0xc9,
  sensor_update_get = 0xca,
  sensor_update_set_unreliable = 0xcb,
  sensor_update_status = 0xcc,
  pos_cmd_set = 0xcd,
  pos_cmd_get = 0xce,
  pos_cmd_set_unreliable = 0xcf,
  pos_cmd_status = 0xd0,
  min_com_set_numbered = 0xd1,
  sensor_update_set_numbered = 0xd2,
  sensor_update_relayed = 0xd4,
};

/// Generic OnOff, two octets, big-endian on air.
constexpr std::uint16_t on_off_get = 0x8201;
constexpr std::uint16_t on_off_set = 0x8202;
constexpr std::uint16_t on_off_set_unacknowledged = 0x8203;
constexpr std::uint16_t on_off_status = 0x8204;

/// Returns `op 59 00` and the parameters.
Bytes vendor_message(Vendor opcode, ByteView parameters);
/// Returns the opcode octet of a message of company 0x0059.
std::optional<Vendor> vendor_opcode(ByteView message);
/// Returns the opcode of a message with a two-octet opcode.
std::optional<std::uint16_t> two_octet_opcode(ByteView message);

/// A receiver needs both keys to understand the message.
struct Encryption {
  Key net_key{};
  Key key{};
  bool is_device_key = false;  ///< else an application key
};

/// An access message on the air. `ttl` as sent.
struct MeshMessage {
  Address source = 0;
  Address destination = 0;
  std::uint8_t ttl = default_ttl;
  Bytes payload;               ///< opcode and parameters
  std::uint32_t sequence = 0;  ///< of the first segment; replay protection compares it
  /// Nothing: the keys of the board.
  std::optional<Encryption> encryption{};
};

/// Of the segments of a message.
struct SegmentAcknowledgement {
  std::uint32_t sequence = 0;
  Key net_key{};
};

/// Returns the number of sequence numbers that a message uses: one for each segment and
/// transmission; messages to a group are sent five times.
std::uint32_t sequence_numbers(Address destination, std::size_t payload_octets, bool is_segmented);

/// 1 up to 11 octets of access payload, else 12 octets each, with the 4-octet TransMIC.
std::size_t segment_count(std::size_t payload_octets);
/// Returns how long a segmented message occupies its sender: 5 x 500 ms to a group, one
/// acknowledgement delay, 150 + 50 x TTL ms, to a unicast address.
Duration segmented_session(Address destination, std::uint8_t ttl);
/// Returns the time between two transmissions of a segmented message to a unicast address: 500 + 50
/// x TTL ms.
Duration retry_interval(std::uint8_t ttl);
constexpr int segmented_transmissions = 5;
/// Returns the time until a segmented message to a silent unicast address has failed.
Duration failed_session(std::uint8_t ttl);
/// Returns the time to the first repeat of a reliable message: 200 ms + 20 ms x TTL (+ 20 ms x
/// segments when segmented).
Duration reliable_interval(std::uint8_t ttl, std::size_t payload_octets);

}  // namespace slamgw::sim::ble
