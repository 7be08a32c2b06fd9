// SPDX-License-Identifier: Apache-2.0
// The commands on their way to one robot: one is sent and repeated until its STATUS comes, the
// others wait. Every command that goes in comes out once, with its outcome. Called by Downlink.
//
// The first repeat comes when the robot should have answered (AnswerTime), but no later than after
// iv, reliable publish's interval; each wait is twice the one before. A segmented message is
// repeated after iv at the earliest, because the board repeats its segments by itself.
//
// A STATUS does not name the command that it answers. When a command was repeated, its other copies
// may be answered after it has ended, and such an answer must not end the next command of the same
// kind, which the robot may not have: so that one waits for a while.
#pragma once

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/robots/answer_time.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/command.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/open_commands.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw::ble {

/// How one command ended.
struct EndedCommand {
  CommandId id = CommandId::none;
  std::string type;
  CommandResult result = CommandResult::delivered;
  std::chrono::milliseconds after{0};
  std::string why;  ///< empty when delivered
  Bytes access;     ///< was sent, and must not be sent again; empty when nothing was
};
using EndedCommands = std::vector<EndedCommand>;

class CommandQueue {
 public:
  /// Promise 6 of docs/topics.md gives 30 s; the rest is for the way to the broker.
  static constexpr Duration time_limit = std::chrono::seconds{29};
  /// Waiting for their turn; more would only grow older than the time limit.
  static constexpr std::size_t max_waiting = 16;

  /// `ttl` of what is sent, for the repeats' timing.
  explicit CommandQueue(std::uint8_t ttl) : ttl_(ttl) {}

  EndedCommands add(Command command, TimePoint now);
  /// The robot sent a STATUS.
  EndedCommands on_status(Opcode status, TimePoint now);
  /// The board did not take the last transmission; the outcome names it if no answer comes.
  void on_send_refused(const std::string& why);
  /// Ends overdue commands.
  EndedCommands on_deadline(TimePoint now);
  EndedCommands refuse_all(const std::string& why, TimePoint now);
  /// Ends the command that was sent, if there is one.
  EndedCommands end_sent(CommandResult result, const std::string& why, TimePoint now);
  /// Removes and returns the commands that were not sent, the oldest first.
  std::vector<WaitingMessage> take_waiting(TimePoint now);

  /// What to send now, if anything.
  std::optional<Bytes> next_transmission(TimePoint now);
  /// The command that next_transmission() gave last, and how often it did.
  struct UnderWay {
    const Command& command;
    int copies;
  };
  UnderWay under_way() const { return {outstanding_->entry.command, outstanding_->copies}; }
  /// `may_send`: next_transmission() is called when it is due.
  std::optional<TimePoint> deadline(bool may_send = true) const;
  /// Appends those that have not ended.
  void list(const std::string& robot, std::vector<OpenCommand>& open) const;
  std::size_t size() const { return waiting_.size() + (outstanding_ ? 1 : 0); }

 private:
  struct Entry {
    Command command;
    TimePoint arrived{};  ///< at the gateway
  };
  struct Outstanding {
    Entry entry;
    TimePoint first_sent{};
    Duration next_offset{};  ///< of the next repeat, after the first transmission
    int copies = 1;          ///< sent so far
    std::string refusal;     ///< why the board did not send one of them; empty when it did
  };

  Duration first_repeat(const Command& command) const;
  TimePoint earliest_start() const;
  void expect_late_answers(TimePoint now);
  EndedCommand end_outstanding(CommandResult result, std::string why, TimePoint now);

  std::uint8_t ttl_;
  AnswerTime answer_time_;
  std::optional<Outstanding> outstanding_;
  /// Until then the robot may answer copies of a command that has ended, with this STATUS.
  TimePoint late_answers_until_{};
  Opcode late_answer_ = 0;
  std::deque<Entry> waiting_;
};

}  // namespace slamgw::ble
