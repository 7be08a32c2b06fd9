// SPDX-License-Identifier: Apache-2.0
// Tells a robot's new acknowledged SET from its repeats of the last one. The models have no
// transaction id and every repeat is a fresh mesh message, so only content and time can tell. One
// filter for each robot and model. Called by BleMesh.
//
// While a SET is open (not answered), the robot refuses to send another: an equal one is a repeat.
// After the STATUS was sent, an equal SET is either a repeat (the STATUS was lost or crossed it) or
// a new message of a robot that stands still. Copies keep to reliable publish's schedule, 0, iv,
// 2iv, 4iv, 8iv ... after the first; updates come at the robot's own period, 200 ms in the thesis,
// which is 80 ms off the nearest gap between copies. An equal SET whose distance from the last copy
// fits the schedule, with up to three copies lost before and between, is taken for a repeat
// (answered again, goes up once); any other is taken for new, because a message that was
// acknowledged must not be lost. Known errors: relays that delay by more than `tolerance` make a
// repeat look new, and a robot that stands still and happens to send every iv loses some of its
// equal updates.
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
  /// Jitter of relays and of the serial line; below the distance of any usual period (100, 200,
  /// 250, 500 ms, 1 s, 2 s) from the gaps at TTL 4.
  static constexpr Duration tolerance = std::chrono::milliseconds{30};
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

  /// A set of copies, the first transmission in bit 0.
  using Copies = std::uint32_t;

  Copies fitting_copies(Duration interval, TimePoint now) const;

  State state_ = State::idle;
  Bytes payload_;
  TimePoint first_heard_{};
  TimePoint last_heard_{};
  TimePoint last_answered_{};
  Copies last_copy_ = 0;  ///< which copies the one heard last can have been
};

}  // namespace slamgw::ble
