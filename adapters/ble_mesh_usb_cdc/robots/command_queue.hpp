// SPDX-License-Identifier: Apache-2.0
// The commands to one robot: one is sent and repeated until its STATUS comes, the others wait. Each
// command leaves the queue once: with its outcome, or unsent by take_waiting(). Called by Downlink.
//
// The first repeat comes when the robot should have answered (AnswerTime), but no later than iv,
// the interval of reliable publish. The time since the first transmission then doubles with each
// repeat. A segmented message is first repeated after iv, because the radio repeats its segments by
// itself.
//
// A STATUS does not name the command that it answers. The robot may answer further copies of a
// repeated command after that command has ended. Such an answer must not end the next command of
// the same kind, which the robot may not have. So that next command waits for a while.
#pragma once

#include <algorithm>
#include <deque>
#include <map>
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

/// Estimates how long one robot takes to answer a command, and so when to repeat a command:
/// smoothed round trip and its variation (RFC 6298). Called by CommandQueue.
class AnswerTime {
 public:
  /// The minimum, however fast a robot answers. A command and its STATUS each wait for the
  /// advertisers of a few relays (20 ms and a random delay for each).
  static constexpr Duration shortest_timeout = std::chrono::milliseconds{100};
  /// Differences between round trips that do not count (G of RFC 6298).
  static constexpr Duration granularity = std::chrono::milliseconds{10};
  /// Doubling ends here; callers' own bounds are far below.
  static constexpr Duration longest_timeout = std::chrono::seconds{30};

  /// Returns the wait before the first repeat: at most `longest`, and `longest` before the first
  /// answer.
  Duration timeout(Duration longest) const {
    return timeout_ == Duration::zero() ? longest : std::min(timeout_, longest);
  }
  /// The robot answered a command that was sent once, this long after the transmission.
  void on_answer(Duration round_trip) {
    round_trip_.on_answer(round_trip);
    timeout_ = std::max(shortest_timeout, round_trip_.timeout());
  }
  /// The robot answered a command that was sent several times, or did not answer. The copy that it
  /// answered is unknown (Karn's rule), so no round trip is learned. The timeout doubles until one
  /// is measured again.
  void on_repeated() { timeout_ = std::min(2 * timeout_, longest_timeout); }

 private:
  RoundTrip round_trip_{granularity};
  Duration timeout_{};  ///< zero: unknown
};

/// One command to a robot in the form for the mesh, made from a broker message under
/// `<prefix>/server/<id>/<type>`. Used by Downlink.
struct Command {
  CommandId id = CommandId::none;
  std::string type;
  Bytes access;                 ///< the acknowledged message to send, opcode first
  Opcode awaited_status = 0;    ///< the robot's answer once it has the command
  bool is_replaceable = false;  ///< a newer one replaces it: positions
  BrokerMessage message{};      ///< the source of the command
};

/// Makes a command, or refuses with a reason for the operator. `settings.pos_cmd_type` becomes
/// pos_cmd SET and takes 4 octets, x and y as little-endian int16 in centimetres. `run` becomes an
/// on/off Set. Any other type is carried unread in min_com SET. `tid`: see encode_on_off_set.
/// `max_send_bytes`: Radio's.
Result<Command, Refusal> make_command(const Settings& settings, std::string_view type,
                                      ByteView payload, std::uint8_t tid,
                                      std::size_t max_send_bytes);

/// A command to a robot that has no outcome yet, as the robot's session on disk keeps it. After a
/// crash the next daemon finds the command there and reports its outcome. It does not send the
/// command again: the robot may have carried it out.
struct OpenCommand {
  std::string type;
  TimePoint arrived{};
  bool is_sent = false;  ///< at least once over the mesh
  bool operator==(const OpenCommand&) const = default;
};

using OpenCommands = std::vector<OpenCommand>;

/// Encodes the open commands of one robot. Times are on the wall clock, which goes on over a
/// restart of the host.
Bytes encode_open_commands(const OpenCommands& commands, const Now& now);
/// Stops where `octets` are damaged. A time ahead of `now` counts as `now`.
OpenCommands decode_open_commands(ByteView octets, const Now& now);
/// Returns the outcome of a command that an earlier daemon had under way.
CommandOutcome outcome_after_restart(const std::string& robot, const OpenCommand& command,
                                     TimePoint now);

/// The outcome of one command, without the robot.
struct EndedCommand : CommandOutcome {
  Bytes access;  ///< was sent, and must not be sent again; empty if never sent
};
using EndedCommands = std::vector<EndedCommand>;

class CommandQueue {
 public:
  /// Promise 6 of docs/topics.md gives 30 s; the rest is for the way to the broker.
  static constexpr Duration time_limit = std::chrono::seconds{29};
  /// Maximum of waiting commands; more would only grow older than the time limit.
  static constexpr std::size_t max_waiting = 16;

  /// `ttl` is that of sent commands; it determines the timing of repeats.
  explicit CommandQueue(std::uint8_t ttl) : ttl_(ttl) {}

  /// Queues the command. Returns the command that this ends: a replaced one, or a refused one.
  EndedCommands add(Command command, TimePoint now);
  /// The robot sent a STATUS. Returns the command that this ends, if any.
  EndedCommands on_status(Opcode status, TimePoint now);
  /// The radio did not take the last transmission. The outcome says why if no answer comes.
  void on_send_refused(const std::string& why);
  /// Ends overdue commands.
  EndedCommands on_deadline(TimePoint now);
  /// Ends all commands: the one that was sent as end_sent() does, the others as `refused`.
  EndedCommands end_all(const std::string& why, TimePoint now);
  /// Ends the command that was sent, if there is one, as `timeout`: the robot may have carried it
  /// out.
  EndedCommands end_sent(const std::string& why, TimePoint now);
  /// Removes and returns the commands that were not sent, the oldest first.
  std::vector<WaitingMessage> take_waiting(TimePoint now);

  struct Transmission {
    const Command& command;
    bool is_repeat;
  };
  /// Returns the command to send now, if any. Overdue commands are for on_deadline().
  std::optional<Transmission> next_transmission(TimePoint now);
  /// `may_send`: includes the time when next_transmission() is due.
  std::optional<TimePoint> deadline(bool may_send = true) const;
  /// Returns the commands that have not ended.
  OpenCommands open_commands() const;
  std::size_t size() const { return waiting_.size() + (outstanding_ ? 1 : 0); }

 private:
  struct Entry {
    Command command;
    TimePoint arrived{};  ///< at the gateway

    bool is_overdue(TimePoint now) const { return now >= arrived + time_limit; }
    EndedCommand end(TimePoint now, CommandResult result, std::string why) const;
  };
  struct Outstanding {
    Entry entry;
    TimePoint first_sent{};
    Duration next_offset{};  ///< of the next repeat, after the first transmission
    int copies = 1;          ///< sent so far
    std::string refusal;     ///< why the radio did not send a copy; empty if it sent all
  };

  Duration first_repeat(const Command& command) const;
  TimePoint earliest_start() const;
  void expect_late_answers(TimePoint now);
  EndedCommand end_outstanding(CommandResult result, std::string why, TimePoint now);

  std::uint8_t ttl_;
  AnswerTime answer_time_;
  std::optional<Outstanding> outstanding_;
  /// Until then, the robot may answer copies of an ended command with this STATUS. At most one
  /// entry for each kind of command.
  std::map<Opcode, TimePoint> late_answers_until_;
  std::deque<Entry> waiting_;
};

}  // namespace slamgw::ble
