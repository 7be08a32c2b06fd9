// SPDX-License-Identifier: Apache-2.0
// Tells a robot's new acknowledged SET from its repeats of the last one. One filter for each robot
// and model. Called by Uplink.
//
// The models have no transaction number, every repeat is a fresh mesh message, and the serial board
// reports no sequence number of the network layer: content and time are all that is left. (Firmware
// can do better: see RepeatFilter::on_numbered_set.)
//
// While a SET is open (not answered), the robot refuses to send another: an equal one is a repeat.
// After the STATUS was sent, an equal SET is either a repeat, because the STATUS was lost, or a new
// message of a robot that stands still. Copies keep to reliable publish's schedule, 0, iv, 2iv,
// 4iv, 8iv ... after the first; new messages come at the robot's own period. So an equal SET whose
// distance from the last copy does not fit the schedule, with up to three copies lost before and
// between, is new. One that fits is
//   - a repeat when the robot's period is known and no new message can arrive now;
//   - in doubt when the two agree, or when the period is not known: `Doubt` says what then.
// Gaps between copies double. Three equal messages at equal distances are therefore the robot's own
// period: those of them that were taken for repeats are made up for.
//
// Known errors: a relay that delays by more than `tolerance` makes a repeat look new, and a robot
// that changes its period to one of the schedule's gaps while it stands still, and then sends no
// third equal message, loses one or two.
//
// A STATUS does not say which SET it is for. A repeat that was on its way when the STATUS left is
// therefore not answered: a second STATUS could meet the robot's next SET and acknowledge that.
// When such a repeat also comes off the schedule (a relay or a busy host has delayed it), it counts
// as not heard at all; a robot whose new message it was sends that again.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

/// The period at which one robot sends new messages of one model, learned from when they arrive.
/// Tells RepeatFilter whether a message that arrives now can be a new one.
class ArrivalPattern {
 public:
  /// Gaps between messages that are looked at.
  static constexpr std::size_t max_gaps = 15;
  /// With fewer the period counts as unknown.
  static constexpr std::size_t min_gaps = 12;
  /// A gap that is at most `regular` away from a whole number of periods is regular. At one that is
  /// `lost` or more away, copies were lost, which shifts a message by repeat intervals. With a gap
  /// between the two the robot or the radio is irregular, and the period counts as unknown; it also
  /// does when most gaps are not regular.
  static constexpr Duration regular = std::chrono::milliseconds{12};
  static constexpr Duration lost = std::chrono::milliseconds{45};
  /// A message this close to its time is on time: twice what is regular.
  static constexpr Duration tolerance = std::chrono::milliseconds{25};
  /// After a longer silence the robot may do something else: its pattern is forgotten.
  static constexpr Duration longest_gap = std::chrono::seconds{60};

  /// A message that is new arrived. `is_certain`: whatever the pattern says; the distance between
  /// two such messages in a row is learned.
  void on_new(bool is_certain, TimePoint now);
  /// The last message was repeated: the next one may be sent late, and its distance is not learned.
  void on_repeat() { is_last_certain_ = false; }
  void forget();
  /// Nothing when the robot's messages are too few or too irregular.
  std::optional<Duration> period() const;
  /// Whether a message that arrives now can be a new one: it comes a whole number of `period`s
  /// after the last one, or up to four repeat intervals later because its first copies were lost,
  /// or up to two earlier because those of the last one were lost. `repeat_interval`:
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
  /// How long a STATUS and then a repeat can be under way: a few hops, two segments, a busy host.
  /// Below the shortest interval of repeats.
  static constexpr Duration crossing_time = std::chrono::milliseconds{100};
  /// A robot that sends this many copies of a message, each after a STATUS, does not hear the
  /// gateway; nor one that sends this many messages in a row, each at least twice. A radio that
  /// loses three of ten makes one message in 400 look so.
  static constexpr int unheard_limit = 5;

  /// What to do with an answered SET that comes again and can be either, new or a repeat.
  enum class Doubt : std::uint8_t {
    take_for_new,     ///< a doubled message is better than a lost one
    take_for_repeat,  ///< unless the robot's period, where it is known, says that it may be new
  };
  enum class Verdict : std::uint8_t {
    fresh,            ///< goes up; the filter is open from now on
    repeat_open,      ///< its receipt has not fired, or its STATUS is on its way: nothing to do
    repeat_answered,  ///< its STATUS was lost: answer again
  };

  /// `interval`: the robot's iv for this message, reliable_interval().
  Verdict on_set(ByteView payload, Duration interval, Doubt doubt, TimePoint now);
  /// A SET with a transaction number: a repeat has number and content of the last one, and a new
  /// message has another number.
  Verdict on_numbered_set(std::uint8_t number, ByteView payload, TimePoint now);
  /// After a fresh one: how many equal messages before it were wrongly taken for repeats. They were
  /// acknowledged, and go up now.
  int missed() const { return missed_; }
  /// The robot repeats the last message, again and again, although its STATUS was sent.
  bool is_unheard() const {
    return unheard_copies_ >= unheard_limit || unheard_messages_ >= unheard_limit;
  }
  /// The gateway speaks from another address: what the robot did not hear before says nothing.
  void forget_unheard() { unheard_copies_ = unheard_messages_ = 0; }
  /// After a fresh one: the robot went on to it because it got the STATUS for the one before.
  bool was_heard() const { return was_heard_; }
  /// A STATUS for the last message is on its way.
  void on_answered(TimePoint now);
  /// The open message was not taken: the next copy goes up again.
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
  Copies last_copy_ = 0;  ///< which copies the one heard last can have been
  ArrivalPattern pattern_;
  /// The same, but in doubt an equal message on the schedule is a repeat: only for what follows.
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
