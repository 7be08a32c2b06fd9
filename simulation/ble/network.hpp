// SPDX-License-Identifier: Apache-2.0
// The boards, the air and the robots together, on one clock that the caller provides: after every
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

/// A mesh of robots behind one board, or behind several, each of which has a gateway of its own and
/// hears all robots. They are counted from 0.
class Network {
 public:
  static constexpr std::chrono::seconds heartbeat_interval{10};

  explicit Network(const BleOptions& options);

  void on_start(TimePoint now);
  void on_host_bytes(ByteView bytes, TimePoint now, std::size_t board = 0);
  /// Handles one event only, so that the host can read between two of them, as on a real wire.
  void on_deadline(TimePoint now);
  TimePoint deadline() const;
  std::optional<Bytes> next_host_packet(TimePoint now, std::size_t board = 0) {
    return boards_[board].next_host_packet(now);
  }
  /// Returns the next event of an update: the robot's number (from 1) and the event.
  std::optional<std::pair<unsigned, UpdateEvent>> next_event();
  /// Returns the next failed assertion of a robot's firmware: the robot's number (from 1) and the
  /// text.
  std::optional<std::pair<unsigned, std::string>> next_failed_assertion();
  /// Restarts the board, without power for `downtime`; the robots keep running.
  void reboot_board(TimePoint now, Duration downtime = Board::reboot_time, std::size_t board = 0,
                    StartEvent start_event = StartEvent::said);

  /// Robots are counted from 1 here.
  void power_cycle_robot(unsigned number) { nodes_[number - 1].power_cycle(); }
  void reset_robot_by_hand(unsigned number, TimePoint now);

  /// Returns true if all updates are sent, acknowledged where requested, and no message is in
  /// flight.
  bool has_sent_everything() const;
  bool has_begun() const { return has_begun_; }
  /// Returns the robots by number, in the order of `nodes()`.
  const std::vector<Robot>& robots() const { return robots_; }
  const std::vector<Node>& nodes() const { return nodes_; }
  const Board& board(std::size_t board = 0) const { return boards_[board]; }

  /// Call before the start, with the content of a state file.
  void restore_board(BoardFlash flash) { boards_[0].restore(std::move(flash)); }
  void restore_node(unsigned number, NodeConfiguration configuration, std::uint32_t next_sequence);

 private:
  /// A segmented message of a board in flight.
  struct Transfer {
    std::size_t board;
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
  bool run_boards(TimePoint now);
  void carry_of_board(std::size_t index, TimePoint now);
  void begin_transfer(std::size_t board, const PacketSender::Transmission& transmission,
                      TimePoint now);
  void carry_heartbeat(std::size_t source, const Heartbeats::Heartbeat& heartbeat, TimePoint now);
  std::vector<unsigned> hops_from(std::size_t source) const;
  bool can_reach(const MeshMessage& message) const;
  void acknowledge_segments(std::size_t index, const MeshMessage& message, TimePoint now);
  bool transmit_to_boards(const MeshMessage& message, TimePoint now);
  bool transmit_to_robots(std::size_t board, const MeshMessage& message, TimePoint now);
  std::vector<Receiver> receivers(TimePoint now) const;
  double loss_of(std::size_t board, TimePoint now) const;
  Robot::Publications publications_of(std::size_t index, TimePoint now);
  Robot::Publications fixed_publications(TimePoint now);
  Robot::Publications for_payload(Robot::Publications publications) const;
  bool is_heard(Address destination, TimePoint now);

  BleOptions options_;
  std::deque<Board> boards_;  ///< at least one
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
