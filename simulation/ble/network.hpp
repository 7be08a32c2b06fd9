// SPDX-License-Identifier: Apache-2.0
// The board, the air and the robots together, on one clock that the caller provides: after every
// input it fetches host packets until there are none, and calls `on_deadline` when `deadline()` has
// passed. SerialSide puts it behind a pty; tests run it on a virtual clock.
#pragma once

#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "simulation/ble/board/board.hpp"
#include "simulation/ble/pb_adv.hpp"
#include "simulation/ble/radio.hpp"
#include "simulation/ble/robot/node.hpp"
#include "simulation/ble/robot/robot.hpp"
#include "simulation/options.hpp"

namespace slamgw::sim::ble {

class Network {
 public:
  static constexpr std::chrono::seconds heartbeat_interval{10};

  explicit Network(const BleOptions& options);

  void on_start(TimePoint now);
  void on_host_bytes(ByteView bytes, TimePoint now);
  /// One event only: the host gets its chance to read between two of them, as on a real wire.
  void on_deadline(TimePoint now);
  TimePoint deadline() const;
  std::optional<Bytes> next_host_packet() { return board_.next_host_packet(); }
  /// What has happened to updates, robot by robot: its number (from 1) and the event.
  std::optional<std::pair<unsigned, UpdateEvent>> next_event();
  /// A robot whose firmware has failed an assertion, and which: its number (from 1) and the words.
  std::optional<std::pair<unsigned, std::string>> next_failed_assertion();
  /// The board restarts, without power for `downtime`; the robots go on.
  void reboot_board(TimePoint now, Duration downtime = Board::reboot_time);

  /// All updates are sent, acknowledged where asked for, and nothing is in the air.
  bool has_sent_everything() const;
  bool has_begun() const { return has_begun_; }
  /// In the order of the robots' numbers, as `nodes()`.
  const std::vector<Robot>& robots() const { return robots_; }
  const std::vector<Node>& nodes() const { return nodes_; }
  const Board& board() const { return board_; }

  /// Before the start, from a state file.
  void restore_board(BoardFlash flash) { board_.restore(std::move(flash)); }
  void restore_node(unsigned number, NodeConfiguration configuration, std::uint32_t next_sequence);

 private:
  /// A segmented message of the board that is under way.
  struct Transfer {
    std::uint64_t id;
    bool is_acknowledged;
  };

  bool run_air(TimePoint now);
  bool run_nodes(TimePoint now);
  bool run_heartbeats(TimePoint now);
  void run_robots(TimePoint now);
  void carry(TimePoint now);
  void carry_of_robot(std::size_t index, TimePoint now);
  void deliver(const Reception& reception, TimePoint now);
  void deliver(const PbAdv::Arrival& arrival, TimePoint now);
  void begin_transfer(const PacketSender::Transmission& transmission, TimePoint now);
  bool can_reach(const MeshMessage& message) const;
  bool transmit(bool is_to_board, const MeshMessage& message, TimePoint now);
  std::optional<Duration> transmit_until_acknowledged(bool is_to_board, const MeshMessage& message,
                                                      TimePoint now);
  Robot::Publications publications_of(std::size_t index, TimePoint now);
  Robot::Publications fixed_publications(TimePoint now);
  Robot::Publications for_payload(Robot::Publications publications) const;
  bool is_heard(Address destination, TimePoint now);

  BleOptions options_;
  Board board_;
  Radio radio_;
  PbAdv pb_adv_;
  std::vector<Robot> robots_;
  std::vector<Node> nodes_;  ///< the mesh stacks of `robots_`
  std::multimap<TimePoint, Transfer> transfers_;
  std::deque<std::pair<unsigned, std::string>> failed_assertions_;
  std::optional<TimePoint> next_heartbeats_;
  bool has_begun_ = false;  ///< the board was ready once; from then on only hearing counts
};

}  // namespace slamgw::sim::ble
