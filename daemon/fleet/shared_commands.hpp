// SPDX-License-Identifier: Apache-2.0
// Commands that all gateways of a fleet hear: this gateway takes those of its robots, refuses those
// that nobody could take, and sees to it that each has one outcome. Pure; part of Ownership.
#pragma once

#include <deque>
#include <map>
#include <string>
#include <utility>

#include "daemon/fleet/command_turns.hpp"
#include "daemon/fleet/membership.hpp"
#include "daemon/fleet/robot_claims.hpp"

namespace slamgw::fleet {

class SharedCommands {
 public:
  SharedCommands(Membership& membership, const RobotClaims& claims)
      : membership_(membership), claims_(claims) {}

  void add(BrokerMessage message, std::string robot, std::string type, const Now& now,
           bool may_be_copy = false);
  void on_own_taken(const Taken& taken, const Now& now);
  void on_taken(const std::string& gateway, Life life, Taken taken, TimePoint now);
  /// Who makes way for this gateway names what it has dealt with.
  void on_release(const std::string& gateway, Life life, const Release& release, TimePoint now);
  /// What a command of this gateway has come to, `after` it came: published by publish_outcomes().
  void on_own_outcome(BrokerMessage outcome, Duration after, TimePoint now);
  void on_outcome(const std::string& gateway, const std::string& robot, const std::string& type,
                  Duration after, TimePoint now);
  /// Asked for each outcome first: the broker brings this one again (DUP), word for word. It would
  /// pass for that of another command of this type.
  bool is_heard_again(const BrokerMessage& outcome, TimePoint now);
  struct Outcome {
    std::string type;
    Duration after{};  ///< zero when it does not say so
  };
  /// Of an outcome's JSON; nothing when it is none.
  static std::optional<Outcome> read(const BrokerMessage& outcome);
  void decide(TimePoint now);
  /// Nobody else is about: what waited for the others waits no longer.
  void decide_alone(TimePoint now);
  /// Nobody else is about whose outcomes could be missing.
  void forget_owed() { turns_.forget_owed(); }
  void end_overdue(TimePoint now);
  void publish_outcomes(TimePoint now);
  /// The broker has an outcome.
  void on_outcome_acknowledged(std::uint64_t id);
  /// The broker does not take an outcome: the store tries it again.
  void on_outcome_refused(std::uint64_t id);
  /// The broker may not have what it has not acknowledged: others may publish it.
  /// `has_heard_others`: it had granted the subscriptions to what they say.
  void on_link_lost(TimePoint now, bool has_heard_others);
  /// `is_session_kept`: the broker delivers what came meanwhile.
  void on_link_up(bool is_session_kept, TimePoint now);
  /// Whether others are about or not.
  void publish_all_outcomes();
  void begin_life() { turns_.on_new_life(); }

  bool is_busy() const { return !turns_.is_empty() || !unpublished_.empty(); }
  std::uint64_t dropped() const { return turns_.dropped(); }

 private:
  struct Unpublished {
    BrokerMessage outcome;
    TimePoint came{};  ///< the command
    std::string robot;
    std::string type;
  };

  /// For how long the broker may have kept a command that comes now.
  Duration kept_before(TimePoint now) const;
  void publish(Unpublished unpublished);
  void settle(Unpublished unpublished, TimePoint now);
  bool is_of_this_life(const Unpublished& unpublished) const;
  /// Who knows what became of a command.
  enum class Knower : std::uint8_t {
    this_gateway,  ///< its life heard the others when the command came
    witnesses,  ///< this one may have missed who took it; gateways that it hears heard the others
    taker,      ///< nobody else
  };
  /// Whether a gateway counts as a witness that was cut off for a moment since then.
  enum class Gaps : std::uint8_t { none, short_ones };
  Knower who_knows_of(TimePoint came, Gaps gaps, TimePoint now) const;
  bool heard_others(TimePoint time) const;
  bool may_taker_return(TimePoint came, TimePoint now) const;
  CommandTurns::Choice choose(const CommandTurns::Waiting& waiting, TimePoint now) const;
  CommandTurns::Choice choose_for_nobody(const CommandTurns::Waiting& waiting, TimePoint now) const;
  CommandTurns::Fate fate_of(const TakenCommands::Entry& owed, TimePoint now) const;
  bool is_left_to_others(TimePoint came, TimePoint now) const;
  bool may_be_left_to_others(TimePoint came, TimePoint now) const;
  bool was_away_since(TimePoint came) const;
  bool still_owns(const CommandTurns::Waiting& waiting, TimePoint now) const;
  void carry_out(CommandTurns::Waiting waiting, TimePoint now);
  void refuse(const CommandTurns::Waiting& waiting, std::string why, TimePoint now);
  void refuse_dropped(TimePoint now);
  int rank_for(const std::string& robot, TimePoint since, TimePoint now) const;

  Membership& membership_;
  const RobotClaims& claims_;
  CommandTurns turns_{membership_.commands};
  /// Outcomes that wait for the lease; max_unpublished at most.
  std::deque<Unpublished> unpublished_;
  std::map<std::uint64_t, Unpublished>
      unacknowledged_;  ///< that the broker has not acknowledged, by id
  std::uint64_t last_published_ = 0;
  /// Outcomes that came lately, by their words; max_unpublished at most.
  std::deque<std::pair<std::uint64_t, TimePoint>> heard_outcomes_;
  std::optional<TimePoint> link_lost_;  ///< in this process
  TimePoint link_up_{};
  bool is_session_kept_ = false;
  /// With the commands the broker keeps what others say of them. Nobody knows of an earlier
  /// process.
  bool are_others_kept_ = true;
  TimePoint unheard_until_{};  ///< commands that were kept without that come before
};

}  // namespace slamgw::fleet
