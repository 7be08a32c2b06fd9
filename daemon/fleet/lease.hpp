// SPDX-License-Identifier: Apache-2.0
// How long this gateway may act for its robots, by its own clock: it acts only while a beat that it
// sent not long ago has come back from the broker. Pure; part of Ownership.
#pragma once

#include "daemon/core/time.hpp"
#include "daemon/fleet/claim.hpp"
#include "daemon/fleet/fleet_message.hpp"

namespace slamgw::fleet {

class Lease {
 public:
  /// The lower 16 bits of `process` are not used.
  explicit Lease(Life process) : life_(process & ~Life{0xffff}) {}

  void begin_life(TimePoint now);
  /// A beat of this life came back. False when this gateway cannot have sent it.
  bool on_own_beat(const Beat& beat, TimePoint now);

  Life life() const { return life_; }
  /// The claims of this process before this life.
  Life first_life() const { return life_ & ~Life{0xffff}; }
  TimePoint life_began() const { return life_began_; }
  /// When the first beat of this life came back, else its start.
  TimePoint joined() const { return joined_; }
  /// For how long this life hears what others say.
  Duration up(TimePoint now) const { return has_echo_ ? now - joined_ : Duration::zero(); }
  bool is_valid(TimePoint now) const { return now < until_; }
  /// Others call this life dead by now, or soon will.
  bool is_life_over(TimePoint now) const { return now >= dead_at_; }

 private:
  Life life_;
  TimePoint life_began_{};
  TimePoint joined_{};
  bool has_echo_ = false;
  TimePoint until_{};
  TimePoint dead_at_{};
};

}  // namespace slamgw::fleet
