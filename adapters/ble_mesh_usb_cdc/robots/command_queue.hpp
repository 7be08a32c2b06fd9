// SPDX-License-Identifier: Apache-2.0
// The commands on their way to one robot: one is sent and repeated until its STATUS comes, the
// others wait. Every command that goes in comes out once, with its outcome. Called by BleMesh.
#pragma once

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/robots/command.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw::ble {

/// How one command ended.
struct EndedCommand {
  CommandId id = CommandId::none;
  std::string type;
  CommandResult result = CommandResult::delivered;
  std::chrono::milliseconds after{0};
  std::string why;  ///< empty when delivered
};
using EndedCommands = std::vector<EndedCommand>;

class CommandQueue {
 public:
  /// The contract promises an outcome within 30 s; the rest is for the way to the broker.
  static constexpr Duration time_limit = std::chrono::seconds{29};
  /// Waiting for their turn; more would only grow older than the time limit.
  static constexpr std::size_t max_waiting = 16;

  /// `ttl` of what is sent, for the repeats' timing.
  explicit CommandQueue(std::uint8_t ttl) : ttl_(ttl) {}

  EndedCommands add(Command command, TimePoint now);
  /// The robot sent a STATUS.
  EndedCommands on_status(Opcode status, TimePoint now);
  /// The board did not take the last transmission; told if the command ends for want of an answer.
  void on_send_refused(const std::string& why);
  /// Ends what is over time.
  EndedCommands on_deadline(TimePoint now);
  EndedCommands refuse_all(const std::string& why, TimePoint now);

  /// What to send now, if anything.
  std::optional<Bytes> next_transmission(TimePoint now);
  std::optional<TimePoint> deadline() const;
  std::size_t size() const { return waiting_.size() + (outstanding_ ? 1 : 0); }

 private:
  struct Entry {
    Command command;
    TimePoint arrived{};
  };
  struct Outstanding {
    Entry entry;
    TimePoint first_sent{};
    Duration next_offset{};  ///< of the next repeat, after the first transmission
    std::string refusal;
  };

  std::uint8_t ttl_;
  std::optional<Outstanding> outstanding_;
  std::deque<Entry> waiting_;
};

}  // namespace slamgw::ble
