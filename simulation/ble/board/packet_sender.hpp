// SPDX-License-Identifier: Apache-2.0
// Packet Send (0xab): its checks, the message for the radio, and TX Complete (0xd2) for firmware
// that has it.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>

#include "simulation/ble/board/board_flash.hpp"
#include "simulation/ble/board/reply.hpp"
#include "simulation/ble/firmware.hpp"

namespace slamgw::sim::ble {

class PacketSender {
 public:
  static constexpr std::size_t max_segmented = 4;
  /// Size of the transport's queue; Packet Send is rejected when it is full.
  static constexpr std::size_t max_unsegmented = 64;

  /// A message for the radio. The board waits for the end of a segmented one.
  struct Transmission {
    MeshMessage message;
    std::optional<std::uint64_t> transfer;  ///< for `on_transfer_ended`
  };

  /// Both must outlive this object.
  PacketSender(const Firmware& firmware, BoardFlash& flash) : firmware_(firmware), flash_(flash) {}

  Reply send(ByteView params, bool is_radio_on, TimePoint now);
  /// Call at the end of a transfer. A failed one causes no event for the host.
  void on_transfer_ended(std::uint64_t transfer, bool is_acknowledged);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  std::optional<Transmission> next_transmission();
  /// Returns a TX Complete: opcode and parameters.
  std::optional<Bytes> next_event();

  /// Command 0xae, once after a start and only without storage: sets the sequence number. Then
  /// event 0xda reports each block of numbers that may be used.
  Reply set_network_state(ByteView params);
  /// Takes `count` sequence numbers, one for each network PDU; returns the first.
  std::uint32_t take_sequence(std::uint32_t count);

  /// Clears RAM, but not flash.
  void reset();
  /// State Clear resets the sequence number: nodes that have heard higher ones from this address
  /// discard the board's messages until it has passed them.
  void on_state_cleared();

 private:
  struct Segmented {
    std::uint64_t transfer;
    std::uint32_t token;
    Address destination;
  };
  struct Request;

  Status check(const Request& request, bool is_radio_on) const;
  Status check_queue(Address destination, bool is_segmented) const;
  std::optional<Encryption> encryption_of(Handle handle) const;
  void reserve_sequence();
  void complete(std::uint32_t token);

  const Firmware& firmware_;
  BoardFlash& flash_;
  std::uint64_t last_transfer_ = 0;  ///< survives a reset, so that old transfers don't end new ones
  std::map<std::uint32_t, TimePoint> unsegmented_;  ///< when each token's message is sent
  std::deque<Segmented> segmented_;
  std::uint32_t next_sequence_ = 0;
  bool is_state_set_ = false;  ///< by the host, which gets an event for each new block
  std::uint32_t last_token_ = 0;
  std::deque<Transmission> to_air_;
  std::deque<Bytes> events_;
};

}  // namespace slamgw::sim::ble
