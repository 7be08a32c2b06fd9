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
  /// The messages of others since the connection before this one are lost.
  void on_gap(TimePoint now);
  /// False when this gateway cannot have sent the beat: it is a forgery.
  static bool is_possible(const Beat& beat, TimePoint now);
  /// A beat of this life, which is_possible(), came back.
  void on_own_beat(const Beat& beat, TimePoint now);

  Life life() const { return life_; }
  /// The claims of this process before this life.
  Life first_life() const { return life_ & ~Life{0xffff}; }
  TimePoint life_began() const { return life_began_; }
  /// When the first beat of this life came back, else its start.
  TimePoint joined() const { return joined_; }
  /// For how long this life hears what others say, but for gaps that are too short to end it.
  Duration up(TimePoint now) const { return has_echo_ ? now - joined_ : Duration::zero(); }
  /// The same since the last gap.
  Duration gapless(TimePoint now) const {
    return is_hearing_ ? now - gap_ended_ : Duration::zero();
  }
  bool is_valid(TimePoint now) const { return now < until_; }
  /// Counts a lease that has run out. To be called often; the Lease itself looks before it is
  /// renewed and before a life begins.
  void look(TimePoint now);
  /// The gateway is alone and needs no lease: that it runs out is not counted.
  void give_up() { is_held_ = false; }
  /// How often it has run out in this process.
  std::uint64_t lapses() const { return lapses_; }
  /// Other gateways treat this life as dead by now, or soon will.
  bool is_life_over(TimePoint now) const { return now >= dead_at_; }

 private:
  Life life_;
  TimePoint life_began_{};
  TimePoint joined_{};
  bool has_echo_ = false;
  bool is_hearing_ = false;
  TimePoint gap_ended_{};
  TimePoint until_{};
  bool is_held_ = false;  ///< by look()
  std::uint64_t lapses_ = 0;
  TimePoint dead_at_{};
};

}  // namespace slamgw::fleet
