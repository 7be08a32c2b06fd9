// SPDX-License-Identifier: Apache-2.0
// Distinguishes a robot's new acknowledged SET from repeats of the last one. There is one filter
// for each robot and model. Called by Uplink.
//
// The models have no transaction number, every repeat is a fresh mesh message, and the serial board
// reports no sequence number of the network layer. Only content and time can tell repeats.
// (Firmware can do better: see RepeatFilter::on_numbered_set.)
//
// While a SET is open (not answered), the robot does not send another, so an equal SET is a repeat.
// After the STATUS was sent, an equal SET is either a repeat, because the STATUS was lost, or a new
// message of a robot that stands still. Copies keep to reliable publish's schedule: 0, iv, 2iv,
// 4iv, 8iv ... after the first. New messages come at the robot's own period. Up to three copies may
// be lost before and between. An equal SET is new if its distance from the last copy does not fit
// the schedule. If it fits, the SET is
//   - a repeat if the robot's period is known and no new message can arrive now;
//   - new if the period is known and a new message can arrive now;
//   - in doubt if the period is unknown: `Doubt` decides.
// Gaps between copies double. Three equal messages at equal distances therefore show the robot's
// own period. Messages among them that were taken for repeats are then reported late.
//
// Known errors: a relay that delays by more than `tolerance` makes a repeat look new. A robot that
// stands still may change its period to one of the schedule's gaps. One or two messages are lost if
// it then sends no third equal message.
//
// A STATUS does not name its SET. So a repeat that was on its way when the STATUS left is not
// answered. A second STATUS could meet the robot's next SET and acknowledge that one. If such a
// repeat does not fit the schedule either (a relay or a busy host has delayed it), it is ignored.
// If it was a new message, the robot sends it again.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

/// Learns the period at which one robot sends new messages of one model, from their arrival times.
/// Says whether a message that arrives now can be new. Called by RepeatFilter.
class ArrivalPattern {
 public:
  /// Number of the last gaps between messages that are used.
  static constexpr std::size_t max_gaps = 15;
  /// With fewer gaps the period is unknown.
  static constexpr std::size_t min_gaps = 12;
  /// A gap at most `regular` away from a whole number of periods is regular. If a gap is `lost` or
  /// more away, copies were lost, which shifts a message by repeat intervals. With a gap between
  /// these two limits the robot or the radio is irregular, and the period is unknown. It is also
  /// unknown unless most gaps are regular.
  static constexpr Duration regular = std::chrono::milliseconds{12};
  static constexpr Duration lost = std::chrono::milliseconds{45};
  /// A message this close to its time is on time; about twice `regular`.
  static constexpr Duration tolerance = std::chrono::milliseconds{25};
  /// After a longer silence the robot may do something else: its pattern is forgotten.
  static constexpr Duration longest_gap = std::chrono::seconds{60};

  /// A new message arrived. `is_certain`: it is new whatever the pattern says. The gap between two
  /// certain messages in a row is learned.
  void on_new(bool is_certain, TimePoint now);
  /// The last message was repeated. The next one may be sent late, so the gap to it is not learned.
  void on_repeat() { is_last_certain_ = false; }
  void forget();
  /// Returns nothing if the robot's messages are too few or too irregular.
  std::optional<Duration> period() const;
  /// Returns true if a message that arrives now can be new: a whole number of `period`s after the
  /// last one. It can come up to four repeat intervals later because its first copies were lost. It
  /// can come up to two earlier because those of the last one were lost. `repeat_interval`:
  /// reliable_interval().
  bool may_be_new(Duration period, Duration repeat_interval, TimePoint now) const;

 private:
  std::deque<Duration> gaps_;
  std::optional<TimePoint> last_new_;
  bool is_last_certain_ = false;
};

class RepeatFilter {
 public:
  /// Jitter of relays and of the serial line.
  static constexpr Duration tolerance = std::chrono::milliseconds{30};
  /// Reliable publish gives up after at most this long.
  static constexpr Duration longest_exchange = std::chrono::seconds{60};
  /// Time for which a STATUS and then a repeat can be under way: a few hops, two segments, a busy
  /// host. Shorter than the shortest interval of repeats.
  static constexpr Duration crossing_time = std::chrono::milliseconds{100};
  /// A robot does not hear the gateway if it sends this many copies of a message, each after a
  /// STATUS. The same holds if it sends this many messages in a row, each at least twice. A radio
  /// that loses three of ten packets makes one message in 400 look so.
  static constexpr int unheard_limit = 5;

  /// Decides about an answered SET that comes again on schedule if the robot's period is unknown.
  enum class Doubt : std::uint8_t {
    take_for_new,     ///< a doubled message is better than a lost one
    take_for_repeat,  ///< unless the robot was seen to use one of the schedule's gaps as period
  };
  enum class Verdict : std::uint8_t {
    fresh,            ///< report it; the filter is open from now on
    repeat_open,      ///< its receipt has not fired, or its STATUS is on its way: nothing to do
    repeat_answered,  ///< its STATUS was lost: answer again
  };

  /// `interval`: the robot's iv for this message, reliable_interval().
  Verdict on_set(ByteView payload, Duration interval, Doubt doubt, TimePoint now);
  /// Judges a SET with a transaction number: a repeat has number and content of the last one, and a
  /// new message has another number.
  Verdict on_numbered_set(std::uint8_t number, ByteView payload, TimePoint now);
  /// Call after `fresh`. Returns how many equal messages before were wrongly taken for repeats.
  /// They were acknowledged already, so report them now.
  int missed() const { return missed_; }
  /// Returns true if the robot repeats its messages again and again although a STATUS was sent.
  bool is_unheard() const {
    return unheard_copies_ >= unheard_limit || unheard_messages_ >= unheard_limit;
  }
  /// Forgets such repeats. Call when the gateway may send from another address from now on.
  void forget_unheard() { unheard_copies_ = unheard_messages_ = 0; }
  /// Call after `fresh`. Returns true if the robot sent it because it got the STATUS before.
  bool was_heard() const { return was_heard_; }
  /// A STATUS for the last message is on its way.
  void on_answered(TimePoint now);
  /// The open message was not taken: its next copy is `fresh` again.
  void on_refused() { state_ = State::idle; }

 private:
  enum class State : std::uint8_t { idle, open, answered };

  /// A set of copies, the first transmission in bit 0.
  using Copies = std::uint32_t;

  Copies fitting_copies(Copies last_copy, Duration interval, TimePoint now) const;
  void open(ByteView payload, std::optional<std::uint8_t> number, TimePoint now);
  void on_copy(bool is_copy, bool is_equal, TimePoint now);
  bool is_repeat(Copies fitting, Duration interval, Doubt doubt, TimePoint now) const;
  Verdict on_repeat(TimePoint now) const;
  bool has_crossed(TimePoint now) const;

  State state_ = State::idle;
  Bytes payload_;
  std::optional<std::uint8_t> number_;  ///< of the last message, if it had one
  TimePoint first_heard_{};
  TimePoint last_heard_{};
  TimePoint last_answered_{};
  Copies last_copy_ = 0;  ///< the copies that the last one heard can have been
  ArrivalPattern pattern_;
  /// As `last_copy_`, but in doubt an equal message on the schedule is a repeat. Only for the
  /// members on hearing that follow.
  Copies likely_copy_ = 0;
  int unheard_copies_ = 0;    ///< of the last message: likely repeats after its STATUS
  int unheard_messages_ = 0;  ///< in a row with such repeats, the last one included
  bool was_heard_ = false;
  Duration last_gap_{};     ///< between the last two arrivals of the same message
  int answered_again_ = 0;  ///< repeats of the last message after its STATUS
  int missed_ = 0;
  bool is_schedule_deceptive_ = false;  ///< the robot's own period is one of the schedule's gaps
};

}  // namespace slamgw::ble
