// SPDX-License-Identifier: Apache-2.0
// Commands that all gateways of a fleet hear: this gateway takes those of its robots, refuses those
// that nobody could take, and sees to it that each has one outcome. Pure; part of Ownership.
#pragma once

#include <deque>
#include <string>

#include "daemon/fleet/command_turns.hpp"
#include "daemon/fleet/membership.hpp"
#include "daemon/fleet/robot_claims.hpp"

namespace slamgw::fleet {

class SharedCommands {
 public:
  SharedCommands(Membership& membership, const RobotClaims& claims)
      : membership_(membership), claims_(claims) {}

  void add(BrokerMessage message, std::string robot, std::string type, const Now& now);
  void on_own_taken(const Taken& taken, const Now& now);
  void on_taken(const std::string& gateway, Life life, const Taken& taken, TimePoint now);
  /// Who makes way for this gateway tells what it has dealt with.
  void on_release(const std::string& gateway, Life life, const Release& release, TimePoint now);
  /// What a command of this gateway has come to, `after` it came: told by tell_outcomes().
  void on_own_outcome(BrokerMessage outcome, Duration after, TimePoint now);
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  TimePoint now);
  void decide(TimePoint now);
  /// Nobody else is about: what waited for the others waits no longer.
  void decide_alone(TimePoint now);
  /// Nobody else is about whose outcomes could be missing.
  void forget_owed() { turns_.forget_owed(); }
  void end_overdue(TimePoint now);
  void tell_outcomes(TimePoint now);
  /// Whether others are about or not.
  void tell_all_outcomes();
  void begin_life() { turns_.on_new_life(); }

  bool is_busy() const { return !turns_.is_empty() || !untold_.empty(); }
  std::uint64_t dropped() const { return turns_.dropped(); }

 private:
  struct Untold {
    BrokerMessage outcome;
    TimePoint came{};
  };

  CommandTurns::Choice choose(const CommandTurns::Waiting& waiting, TimePoint now) const;
  CommandTurns::Fate fate_of(const CommandTurns::Owed& owed, TimePoint now) const;
  bool still_owns(const CommandTurns::Waiting& waiting, TimePoint now) const;
  void refuse(const CommandTurns::Waiting& waiting, std::string why, TimePoint now);
  void refuse_dropped(TimePoint now);
  int rank_for(const std::string& robot, TimePoint now) const;

  Membership& membership_;
  const RobotClaims& claims_;
  CommandTurns turns_{membership_.done};
  std::deque<Untold> untold_;  ///< outcomes that wait for the lease; at most max_untold
};

}  // namespace slamgw::fleet
