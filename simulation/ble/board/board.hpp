// SPDX-License-Identifier: Apache-2.0
// Nordic's serial firmware (nRF5 SDK for Mesh 3.1.0, stock serial example) as its host sees it:
// frames `len op params` in, responses and events out, tables with handles, every status code where
// the real one gives it. No port and no clock: Network feeds it and carries what it transmits.
//
// Not simulated, answered as unknown (82): beacons, DFU, virtual addresses, the host-side access
// layer (0xe0-0xfd), and what 3.1.0 itself does not implement.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>

#include "simulation/ble/board/board_tables.hpp"
#include "simulation/ble/board/provisioner.hpp"
#include "simulation/ble/replay_list.hpp"

namespace slamgw::sim::ble {

/// A message as it reaches the board's radio.
struct Reception {
  MeshMessage message;
  std::uint8_t ttl = 0;  ///< on arrival
  std::int8_t rssi_dbm = 0;
};

class Board {
 public:
  static constexpr std::size_t transmit_buffer = 2 * 256;  ///< octets towards the host
  static constexpr std::size_t segmented_sessions = 4;
  static constexpr std::chrono::milliseconds reboot_time{100};

  /// What the board gives to the radio. Of a segmented message it waits for the end.
  struct Transmission {
    MeshMessage message;
    std::optional<std::uint64_t> transfer;  ///< for `on_transfer_ended`
  };

  explicit Board(Random random);

  /// As an earlier session left it: key index 0 of both kinds, address 0x0001, the three groups.
  void configure(const Key& net_key, const Key& app_key);

  void on_power_up(TimePoint now);
  /// Its RAM is void; it starts after `downtime`.
  void reboot(TimePoint now, Duration downtime = reboot_time);
  void on_host_bytes(ByteView bytes, TimePoint now);
  void on_radio(const Reception& reception);
  void on_beacon(const Beacon& beacon);
  /// Only firmware 4.0 and later tells its host.
  void on_heartbeat(Address source, std::uint8_t initial_ttl, std::uint8_t hops);
  void on_link_signal(const LinkSignal& signal, TimePoint now);
  /// A failed transfer shows to the host only by what does not come.
  void on_transfer_ended(std::uint64_t transfer, bool is_acknowledged);
  void on_deadline(TimePoint now);
  std::optional<TimePoint> deadline() const;

  /// The next packet for the host. What is not fetched fills the transmit buffer; when that is
  /// full, responses and events are dropped, which only command 0x14 tells.
  std::optional<Bytes> next_host_packet();
  std::optional<Transmission> next_transmission();
  std::optional<LinkSignal> next_link_signal() { return provisioner_.next_link_signal(); }

  /// A message to this address with the board's application key would become an event.
  bool hears(Address destination) const;
  /// The board can hear, and its host has configured nothing for half a second: a robot may speak.
  bool is_ready_for(Address destination, TimePoint now) const;
  /// The gateway's unicast address; 0 while it has none.
  Address local_address() const { return flash_.local_start; }

  const BoardFlash& flash() const { return flash_; }
  /// Before power-up.
  void restore(BoardFlash flash);

 private:
  struct Command {
    std::uint8_t opcode;
    std::uint8_t min_params;
    std::uint8_t max_params;
    Reply (Board::*run)(ByteView params, TimePoint now);
  };
  struct Session {
    std::uint64_t transfer;
    std::uint32_t token;
    Address destination;
  };
  struct Handles {
    Handle key;
    Handle subnet;
  };

  static const Command* find_command(std::uint8_t opcode);
  void on_packet(ByteView packet, TimePoint now);
  void on_provisioning(std::uint8_t opcode, ByteView params, TimePoint now);
  void forward_events();
  bool listens_to(Address destination) const;
  std::optional<Handles> decrypt(const MeshMessage& message) const;
  void send_tx_complete(std::uint32_t token);
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
  std::optional<Encryption> encryption_of(Handle handle) const;
  std::uint32_t take_sequence(std::uint32_t count);

  BoardFlash flash_;
  std::uint64_t last_transfer_ = 0;  ///< outlives a reset, so that old transfers don't end new ones
  // Void after a reset
  std::optional<TimePoint> boots_at_;
  bool is_enabled_ = false;
  Key uuid_{};
  Provisioner provisioner_;
  std::map<std::uint32_t, TimePoint> tokens_;  ///< TX Complete is due; at most max_tokens
  std::deque<Session> sessions_;
  ReplayList heard_;
  std::uint32_t next_sequence_ = 0;
  std::uint32_t last_token_ = 0;
  std::uint32_t dropped_ = 0;
  std::optional<TimePoint> last_setup_;  ///< the host's last command that changes or reads tables
  Bytes partial_;                        ///< a packet that has begun: length octet first
  std::deque<Bytes> to_host_;
  std::size_t to_host_octets_ = 0;
  std::deque<Transmission> to_air_;
};

}  // namespace slamgw::sim::ble
