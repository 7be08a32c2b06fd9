// SPDX-License-Identifier: Apache-2.0
// The period at which one robot sends new messages of one model, learned from when they arrive.
// Tells SetFilter whether a message that arrives now can be a new one.
#pragma once

#include <cstddef>
#include <deque>
#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw::ble {

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

}  // namespace slamgw::ble
