// SPDX-License-Identifier: Apache-2.0
// Nordic's serial firmware (stock serial example of the nRF5 SDK for Mesh) as its host sees it:
// frames `len op params` in, responses and events out, tables with handles, and the status codes of
// the real one, in each release of firmware.hpp. No port and no clock: Network
// feeds it and carries what it transmits.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "simulation/ble/board/address_commands.hpp"
#include "simulation/ble/board/device_commands.hpp"
#include "simulation/ble/board/key_commands.hpp"
#include "simulation/ble/board/packet_sender.hpp"
#include "simulation/ble/board/provisioner.hpp"
#include "simulation/ble/replay_list.hpp"

namespace slamgw::sim::ble {

/// A message as it reaches the board's radio.
struct Reception {
  MeshMessage message;
  std::uint8_t ttl = 0;  ///< on arrival
  std::int8_t rssi_dbm = 0;
  std::optional<std::size_t> board{};  ///< the receiving board; nothing: the robots
};

/// Whether the board's tables and sequence number outlive a reset. Nordic's serial example is built
/// without storage in each release.
enum class BoardStorage : std::uint8_t { none, flash };

/// Whether the host gets the board's Device Started event. It does not when the board restarts
/// while its port loses octets.
enum class StartEvent : std::uint8_t { said, lost };

class Board {
 public:
  static constexpr std::chrono::milliseconds reboot_time{100};

  /// Maximum of octets from the host on the line; more are lost, as without flow control.
  static constexpr std::size_t max_on_line = 65536;

  /// `firmware` must outlive this object. An octet takes `octet_time` on the serial line, either
  /// way.
  Board(const Firmware& firmware, BoardStorage storage, Random random, Duration octet_time = {});
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  /// Configures the board like an earlier session: key index 0 of both kinds, address 0x0001, the
  /// three groups.
  void configure(const Key& net_key, const Key& app_key);

  void on_power_up();
  /// Clears RAM, and without storage the tables; starts again after `downtime`.
  void reboot(TimePoint now, Duration downtime = reboot_time,
              StartEvent start_event = StartEvent::said);
  void on_host_bytes(ByteView bytes, TimePoint now);
  void on_radio(const Reception& reception);
  void on_beacon(const Beacon& beacon);
  /// Only firmware 4.0 and later reports it to its host. `net_key`: nothing for the board's keys.
  void on_heartbeat(Address source, const std::optional<Key>& net_key, std::uint8_t initial_ttl,
                    std::uint8_t hops);
  void on_link_signal(const LinkSignal& signal, TimePoint now);
  /// Call at the end of a transfer. A failed one causes no event for the host.
  void on_transfer_ended(std::uint64_t transfer, bool is_acknowledged);
  /// Repeats segments, whose PDUs have new sequence numbers.
  void repeat_segments(std::size_t count) {
    sender_.take_sequence(static_cast<std::uint32_t>(count));
  }
  /// Returns the acknowledgement of a message's segments if its address and network key are the
  /// board's. It comes from that address.
  std::optional<SegmentAcknowledgement> acknowledge_segments(const MeshMessage& message);
  void on_deadline(TimePoint now);
  std::optional<TimePoint> deadline() const;

  /// Returns the next packet for the host once it has passed the line.
  std::optional<Bytes> next_host_packet(TimePoint now) { return to_host_.pop(now); }
  std::optional<PacketSender::Transmission> next_transmission() {
    return sender_.next_transmission();
  }
  std::optional<LinkSignal> next_link_signal() { return provisioner_.next_link_signal(); }

  /// Returns true if a message to this address with the board's application key causes an event.
  bool hears(Address destination) const;
  /// Returns true if the board receives and was not configured for half a second: robots may send.
  bool is_ready_for(Address destination, TimePoint now) const;
  /// Returns the gateway's unicast address; 0 while it has none.
  Address local_address() const { return flash_.local_start; }

  const BoardFlash& flash() const { return flash_; }
  bool has_storage() const { return storage_ == BoardStorage::flash; }
  /// Call before power-up.
  void restore(BoardFlash flash);

 private:
  struct Handles {
    Handle key;
    Handle subnet;
  };

  void take_from_line(TimePoint now);
  std::optional<TimePoint> next_command_at() const;
  void on_octet(std::uint8_t octet, TimePoint now);
  void on_packet(ByteView packet, TimePoint now);
  std::optional<Reply> run_command(std::uint8_t opcode, ByteView params, TimePoint now);
  Reply set_enabled(bool is_enabled);
  Reply state_clear();
  Reply set_network_state(ByteView params);
  void on_provisioning(std::uint8_t opcode, ByteView params, TimePoint now);
  void forward_events();
  bool listens_to(Address destination) const;
  std::optional<Handles> decrypt(const MeshMessage& message) const;
  void respond(std::uint8_t opcode, const Reply& reply);

  const Firmware& firmware_;
  const BoardStorage storage_;
  const Duration octet_time_;
  std::deque<std::uint8_t> on_line_;  ///< on their way from the host
  TimePoint next_octet_at_{};         ///< when the first of them is at the board
  BoardFlash flash_;                  ///< without storage in RAM, as all below
  // Cleared by a reset
  std::optional<TimePoint> boots_at_;
  StartEvent start_event_ = StartEvent::said;
  bool is_enabled_ = false;
  TransmitBuffer to_host_;
  DeviceCommands device_;
  KeyCommands keys_;
  AddressCommands addresses_;
  PacketSender sender_;
  Provisioner provisioner_;
  ReplayList heard_;
  std::optional<TimePoint> last_setup_;  ///< the host's last command that changes or reads tables
  Bytes partial_;                        ///< a packet that has begun: length octet first
};

}  // namespace slamgw::sim::ble
