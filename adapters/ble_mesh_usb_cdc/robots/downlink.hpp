// SPDX-License-Identifier: Apache-2.0
// The way down: a command from the broker goes into its robot's queue, is sent and repeated through
// the radio, and ends in one outcome. Part of BleMesh.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/robots/robot.hpp"
#include "daemon/core/log_throttle.hpp"

namespace slamgw::ble {

class Downlink : private MeshPart {
 public:
  /// Maximum of topics whose retained message one robot gets each time that it comes online.
  static constexpr std::size_t max_retained = CommandQueue::max_waiting;
  static constexpr const char* gateway_ends = "the gateway is stopping";

  explicit Downlink(const MeshPart& shared) : MeshPart(shared) {}
  /// See BleMesh.
  void begin_tids_after(std::uint8_t tid) { last_tid_ = tid; }

  /// Queues a command of this type for `robot`, or ends it as refused. Commands wait for the radio
  /// until it has said whether the link is up: at the daemon's start they come before that. Drops a
  /// retained command that the robot does not wait for.
  void on_command(Robot& robot, std::string_view type, const BrokerMessage& message, CommandId id,
                  TimePoint now);
  /// The robot sent a STATUS. Returns true if it is the answer to a command.
  bool on_status(Robot& robot, Opcode status, TimePoint now);
  void on_deadline(Robot& robot, TimePoint now);
  std::optional<TimePoint> deadline(const Robot& robot) const;
  /// See CommandQueue::end_all.
  void end_all(Robot& robot, const std::string& why, TimePoint now);
  /// Another gateway serves the robot. Returns the commands that were not sent; the one that was
  /// sent ends as `timeout`, because the robot may have carried it out.
  std::vector<WaitingMessage> give_up(Robot& robot, TimePoint now);
  /// Refuses all further commands, because the daemon ends.
  void on_stop() { is_stopping_ = true; }

  std::uint64_t retained_dropped() const { return retained_dropped_; }
  std::uint64_t ended(CommandResult result) const {
    return ended_[static_cast<std::size_t>(result)];
  }

 private:
  bool may_take_retained(Robot& robot, const BrokerMessage& message, TimePoint now);
  bool may_send_to(const Robot& robot) const;
  void transmit_due(Robot& robot, TimePoint now);
  void conclude(const Robot& robot, EndedCommands ended);

  std::uint8_t last_tid_ = 0;
  bool is_stopping_ = false;
  std::uint64_t retained_dropped_ = 0;
  LogThrottle retained_throttle_;
  std::array<std::uint64_t, command_result_count> ended_{};  ///< by CommandResult
};

}  // namespace slamgw::ble
