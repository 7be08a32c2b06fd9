// SPDX-License-Identifier: Apache-2.0
// The commands on their way to one robot: one is sent and repeated until its STATUS comes, the
// others wait. Every command that goes in comes out once, with its outcome. Called by Downlink.
//
// The first repeat comes when the robot should have answered (AnswerTime), but no later than after
// iv, reliable publish's interval; each wait is twice the one before. A segmented message is
// repeated after iv at the earliest, because the radio repeats its segments by itself.
//
// A STATUS does not name the command that it answers. When a command was repeated, its other copies
// may be answered after it has ended, and such an answer must not end the next command of the same
// kind, which the robot may not have: so that one waits for a while.
#pragma once

#include <algorithm>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/radio.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/round_trip.hpp"

namespace slamgw::ble {

/// How long one robot takes to answer a command, and so when to repeat one: the smoothed round trip
/// and its variation (RFC 6298). Called by CommandQueue.
class AnswerTime {
 public:
  /// However fast a robot answers: a command and its STATUS each wait for the advertisers of a few
  /// relays (20 ms and a random delay for each).
  static constexpr Duration shortest_timeout = std::chrono::milliseconds{100};
  /// Differences between round trips that are no news (G of RFC 6298).
  static constexpr Duration granularity = std::chrono::milliseconds{10};
  /// Doubling ends here; callers' own bounds are far below.
  static constexpr Duration longest_timeout = std::chrono::seconds{30};

  /// The wait before the first repeat: at most `longest`, which it also is before the first answer.
  Duration timeout(Duration longest) const {
    return timeout_ == Duration::zero() ? longest : std::min(timeout_, longest);
  }
  /// The robot answered a command that was sent once, this long after it was sent.
  void on_answer(Duration round_trip) {
    round_trip_.on_answer(round_trip);
    timeout_ = std::max(shortest_timeout, round_trip_.timeout());
  }
  /// It answered one that was sent several times, or did not answer. To which copy it answered
  /// is unknown (Karn's rule): it teaches no round trip, but the timeout doubles until one is
  /// measured again.
  void on_repeated() { timeout_ = std::min(2 * timeout_, longest_timeout); }

 private:
  RoundTrip round_trip_{granularity};
  Duration timeout_{};  ///< zero: unknown
};

/// One command to a robot, as it goes over the mesh: made from a broker message under
/// `<prefix>/server/<id>/<type>`, or refused with a reason for the operator. Called by Downlink.
struct Command {
  CommandId id = CommandId::none;
  std::string type;
  Bytes access;                 ///< the acknowledged message to send, opcode first
  Opcode awaited_status = 0;    ///< what the robot answers when it has it
  bool is_replaceable = false;  ///< a newer one makes it pointless: positions
  BrokerMessage message{};      ///< that it was made from
};

/// `settings.pos_cmd_type` becomes pos_cmd SET and takes 4 octets, x and y as little-endian int16
/// in centimetres; `run` becomes an on/off Set; any other type is carried unread in min_com SET.
/// The error says why not. `tid`: see encode_on_off_set. `max_send_bytes`: Radio's.
Result<Command, Refusal> make_command(const Settings& settings, std::string_view type,
                                      ByteView payload, std::uint8_t tid,
                                      std::size_t max_send_bytes);

/// A command to a robot that has no outcome yet, as the robot's session on disk keeps it. A daemon
/// that was killed finds it there when it starts again, and reports its outcome. It is not sent
/// again: the robot may have carried it out.
struct OpenCommand {
  std::string robot;
  std::string type;
  TimePoint arrived{};
  bool is_sent = false;  ///< at least once over the mesh
  bool operator==(const OpenCommand&) const = default;
};

using OpenCommands = std::vector<OpenCommand>;

/// The open commands of one robot. Times are kept by the wall clock, which goes on over a restart
/// of the host.
Bytes encode_open_commands(const OpenCommands& commands, const Now& now);
/// Ends where `octets` are damaged. A time ahead of `now` counts as `now`.
OpenCommands decode_open_commands(std::string_view robot, ByteView octets, const Now& now);
/// The outcome of a command that an earlier daemon had under way.
CommandOutcome outcome_after_restart(const OpenCommand& command, TimePoint now);

/// How one command ended, without the robot.
struct EndedCommand : CommandOutcome {
  Bytes access;  ///< was sent, and must not be sent again; empty when nothing was
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
  /// The radio did not take the last transmission; the outcome names it if no answer comes.
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
  void list(const std::string& robot, OpenCommands& open) const;
  std::size_t size() const { return waiting_.size() + (outstanding_ ? 1 : 0); }

 private:
  struct Entry {
    Command command;
    TimePoint arrived{};  ///< at the gateway

    EndedCommand end(TimePoint now, CommandResult result, std::string why) const;
  };
  struct Outstanding {
    Entry entry;
    TimePoint first_sent{};
    Duration next_offset{};  ///< of the next repeat, after the first transmission
    int copies = 1;          ///< sent so far
    std::string refusal;     ///< why the radio did not send one of them; empty when it did
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
