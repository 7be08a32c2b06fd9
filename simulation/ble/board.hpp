// SPDX-License-Identifier: Apache-2.0
// Nordic's serial firmware (nRF5 SDK for Mesh 3.1.0, stock serial example) as its host sees it:
// frames `len op params` in, responses and events out, tables with handles, every status code where
// the real one gives it. No port and no clock: BleNetwork feeds it and carries what it transmits.
//
// Not simulated, answered as unknown (82): beacons, DFU, virtual addresses, the host-side access
// layer (0xe0-0xfd), and what 3.1.0 itself does not implement.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>

#include "simulation/ble/board_tables.hpp"

namespace slamgw::sim::ble {

struct BoardSettings {
  unsigned robots = 0;              ///< reachable at first_robot ...
  bool has_segment_timing = false;  ///< segmented messages occupy the board as long as on air
};

/// A message as it reaches the board's radio.
struct Reception {
  MeshMessage message;
  std::uint8_t ttl = 0;  ///< on arrival
  std::int8_t rssi_dbm = 0;
};

class Board {
 public:
  static constexpr std::size_t transmit_buffer = 2 * 256;  ///< octets towards the host
  static constexpr std::size_t replay_list = 40;           ///< sources that can be heard
  static constexpr std::size_t segmented_sessions = 4;
  static constexpr std::chrono::milliseconds reboot_time{100};

  explicit Board(BoardSettings settings);

  /// As an earlier session left it: key index 0 of both kinds, address 0x0001, the three groups.
  void configure(const Key& net_key, const Key& app_key);

  void on_power_up(TimePoint now);
  void on_host_bytes(ByteView bytes, TimePoint now);
  void on_radio(const Reception& reception);
  void on_deadline(TimePoint now);
  std::optional<TimePoint> deadline() const;

  /// The next packet for the host. What is not fetched fills the transmit buffer; when that is
  /// full, responses and events are dropped, which only command 0x14 tells.
  std::optional<Bytes> next_host_packet();
  std::optional<MeshMessage> next_transmission();

  /// A message to this address would become an event.
  bool hears(Address destination) const;
  /// The board can hear, and its host has configured nothing for half a second: a robot may speak.
  bool is_ready_for(Address destination, TimePoint now) const;
  /// The gateway's unicast address; 0 while it has none.
  Address local_address() const { return local_start_; }

 private:
  struct Reply {
    Status status = Status::success;
    Bytes data;
  };
  struct Command {
    std::uint8_t opcode;
    std::uint8_t min_params;
    std::uint8_t max_params;
    Reply (Board::*run)(ByteView params, TimePoint now);
  };
  struct Session {
    Address destination;
    TimePoint until;
  };

  static const Command* find_command(std::uint8_t opcode);
  void on_packet(ByteView packet, TimePoint now);
  void reboot(TimePoint now);
  void on_provisioning(std::uint8_t opcode, ByteView params, TimePoint now);
  void send_to_host(Bytes opcode_and_params);
  void respond(std::uint8_t opcode, const Reply& reply);

  Reply serial_version(ByteView, TimePoint);
  Reply housekeeping_get(ByteView, TimePoint);
  Reply housekeeping_clear(ByteView, TimePoint);
  Reply refuse_application(ByteView, TimePoint);
  Reply uuid_set(ByteView, TimePoint);
  Reply uuid_get(ByteView, TimePoint);
  Reply enable(ByteView, TimePoint);
  Reply disable(ByteView, TimePoint);
  Reply subnet_add(ByteView, TimePoint);
  Reply subnet_update(ByteView, TimePoint);
  Reply subnet_delete(ByteView, TimePoint);
  Reply subnet_get_all(ByteView, TimePoint);
  Reply subnet_count_max(ByteView, TimePoint);
  Reply appkey_add(ByteView, TimePoint);
  Reply appkey_update(ByteView, TimePoint);
  Reply appkey_delete(ByteView, TimePoint);
  Reply appkey_get_all(ByteView, TimePoint);
  Reply appkey_count_max(ByteView, TimePoint);
  Reply devkey_add(ByteView, TimePoint);
  Reply devkey_delete(ByteView, TimePoint);
  Reply devkey_count_max(ByteView, TimePoint);
  Reply local_unicast_set(ByteView, TimePoint);
  Reply local_unicast_get(ByteView, TimePoint);
  Reply subscription_add(ByteView, TimePoint);
  Reply subscription_remove(ByteView, TimePoint);
  Reply publication_add(ByteView, TimePoint);
  Reply publication_remove(ByteView, TimePoint);
  Reply address_get(ByteView, TimePoint);
  Reply address_get_all(ByteView, TimePoint);
  Reply nonvirtual_count_max(ByteView, TimePoint);
  Reply virtual_count_max(ByteView, TimePoint);
  Reply packet_send(ByteView, TimePoint);
  Reply state_clear(ByteView, TimePoint);

  Status check_packet_send(ByteView params) const;
  bool can_reach(Address destination) const;

  BoardSettings settings_;
  // Kept over a reset
  KeyTable subnets_{8, 0};
  KeyTable appkeys_{8, 0};
  KeyTable devkeys_{10, 8};  // handles follow those of the application keys
  AddressTable addresses_;
  Address local_start_ = 0;
  std::uint16_t local_count_ = 0;
  // Void after a reset
  std::optional<TimePoint> boots_at_;
  bool is_enabled_ = false;
  bool is_scanning_ = false;
  Key uuid_{};
  std::map<std::uint8_t, TimePoint> link_timeouts_;  ///< provisioning contexts 0 and 1
  std::map<std::uint32_t, TimePoint> tokens_;        ///< TX Complete is due; at most max_tokens
  std::deque<Session> sessions_;
  std::set<Address> heard_;
  std::uint32_t last_token_ = 0;
  std::uint32_t dropped_ = 0;
  std::optional<TimePoint> last_setup_;  ///< the host's last command that changes or reads tables
  Bytes partial_;                        ///< a packet that has begun: length octet first
  std::deque<Bytes> to_host_;
  std::size_t to_host_octets_ = 0;
  std::deque<MeshMessage> to_air_;
};

}  // namespace slamgw::sim::ble
