// SPDX-License-Identifier: Apache-2.0
// Tells a robot's new acknowledged SET from its repeats of the last one. The models have no
// transaction id and every repeat is a fresh mesh message, so only content and time can tell. One
// filter for each robot and model. Called by BleMesh.
//
// While a SET is open (not answered), the robot refuses to send another: an equal one is a repeat.
// After the STATUS was sent, an equal SET is either a repeat (the STATUS was lost or crossed it) or
// a new message of a robot that stands still. Repeats keep to reliable publish's schedule, so the
// gaps between copies are iv, iv, 2iv, 4iv ...; updates come at the robot's own period, 200 ms in
// the thesis, which is 80 ms off the nearest gap. An equal SET on the schedule is taken for a
// repeat (answered again, goes up once); off the schedule it is taken for new, because a message
// that was acknowledged must not be lost. Known error: with a copy *and* a STATUS lost the gap is
// not on the schedule and the message goes up twice; a robot that stands still and happens to send
// every iv loses some of its equal updates.
//
// A STATUS does not say which SET it is for. A repeat that was on its way when the STATUS left is
// therefore not answered: a second STATUS could meet the robot's next SET and acknowledge that.
#pragma once

#include <cstdint>

#include "daemon/core/bytes.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

class RepeatFilter {
 public:
  /// Jitter of relays and of the serial line, well below the 80 ms above.
  static constexpr Duration tolerance = std::chrono::milliseconds{50};
  /// Reliable publish gives up after at most this long.
  static constexpr Duration longest_exchange = std::chrono::seconds{60};
  /// How long a repeat and a STATUS can take to cross: a few hops.
  static constexpr Duration crossing_time = std::chrono::milliseconds{60};

  enum class Verdict : std::uint8_t {
    fresh,            ///< goes up; the filter is open from now on
    repeat_open,      ///< its receipt has not fired, or its STATUS is on its way: nothing to do
    repeat_answered,  ///< its STATUS was lost: answer again
  };

  /// `interval`: the robot's iv for this message.
  Verdict on_set(ByteView payload, Duration interval, TimePoint now);
  /// A STATUS for the last message is on its way.
  void on_answered(TimePoint now);
  /// The open message was not taken: the next copy goes up again.
  void on_refused() { state_ = State::idle; }

 private:
  enum class State : std::uint8_t { idle, open, answered };

  bool is_on_schedule(Duration interval, TimePoint now);

  State state_ = State::idle;
  Bytes payload_;
  TimePoint first_heard_{};
  TimePoint last_heard_{};
  TimePoint last_answered_{};
  int doublings_ = 0;    ///< of the gap, as far as seen
  int single_gaps_ = 0;  ///< gaps of one iv: there are at most two
};

}  // namespace slamgw::ble
