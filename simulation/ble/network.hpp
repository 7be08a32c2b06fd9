// SPDX-License-Identifier: Apache-2.0
// The board, the air and the robots together, on one clock that the caller provides: after every
// input it fetches host packets until there are none, and calls `on_deadline` when `deadline()` has
// passed. SerialSide puts it behind a pty; tests run it on a virtual clock.
#pragma once

#include <optional>
#include <vector>

#include "simulation/ble/board.hpp"
#include "simulation/ble/radio.hpp"
#include "simulation/ble/robot.hpp"
#include "simulation/options.hpp"

namespace slamgw::sim::ble {

class Network {
 public:
  explicit Network(const BleOptions& options);

  void on_start(TimePoint now);
  void on_host_bytes(ByteView bytes, TimePoint now);
  /// One event only: the host gets its chance to read between two of them, as on a real wire.
  void on_deadline(TimePoint now);
  TimePoint deadline() const;
  std::optional<Bytes> next_host_packet() { return board_.next_host_packet(); }

  /// All updates are sent, acknowledged where asked for, and nothing is in the air.
  bool has_sent_everything() const;
  bool has_begun() const { return has_begun_; }
  /// In the order of the robots' numbers.
  const std::vector<Robot>& robots() const { return robots_; }

 private:
  void carry(TimePoint now);
  void deliver(const Reception& reception, TimePoint now);
  Robot::Gateway gateway_for(const Robot& robot, TimePoint now);

  Board board_;
  Radio radio_;
  std::vector<Robot> robots_;
  bool has_begun_ = false;  ///< the board was ready once; from then on only hearing counts
};

}  // namespace slamgw::sim::ble
