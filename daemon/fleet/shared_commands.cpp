// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/shared_commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t max_untold = 65'536;  // as CommandLedger
/// Who would tell an overdue outcome in another gateway's place, and was cut off itself when it
/// became due, gives that gateway so long to come back and tell it.
constexpr std::chrono::seconds owner_returns{10};
/// A process that others hear again in a new life before its command is so old tells the outcome
/// itself; it has not forgotten the command.
constexpr std::chrono::seconds back_in_time{28};

}  // namespace

void SharedCommands::add(BrokerMessage message, std::string robot, std::string type,
                         const Now& now) {
  const auto choose_now = [&](const auto& waiting) { return choose(waiting, now.mono); };
  for (const Taken& taken :
       turns_.add(std::move(message), std::move(robot), std::move(type), choose_now, now.mono))
    membership_.tell_all(taken);
  refuse_dropped(now.mono);
}

/// There was no room for them. Their owner says so, or who is alone.
void SharedCommands::refuse_dropped(TimePoint now) {
  for (const auto& waiting : turns_.take_dropped()) {
    const bool is_owner = membership_.may_act(now) && claims_.is_held(waiting.robot);
    if (is_owner)
      membership_.tell_all(Taken{waiting.taking, waiting.key, waiting.robot, waiting.type});
    if (is_owner || membership_.phase == Phase::alone)
      refuse(waiting, "too many commands are on their way", now);
  }
}

void SharedCommands::refuse(const CommandTurns::Waiting& waiting, std::string why, TimePoint now) {
  membership_.actions.push(EndCommand{waiting.robot, waiting.type, CommandResult::refused,
                                      std::move(why), now - waiting.came});
}

void SharedCommands::decide(TimePoint now) {
  if (turns_.is_empty()) return;
  const auto said = turns_.decide(
      [&](const CommandTurns::Waiting& waiting) { return choose(waiting, now); }, now);
  for (const Taken& taken : said) membership_.tell_all(taken);
  if (!membership_.lease.is_valid(now)) return;
  for (const Taken& taken : turns_.repeat(now)) membership_.tell_all(taken);
  for (const auto& waiting : turns_.take_refused(now)) {
    refuse(waiting,
           waiting.is_refusal ? "no gateway serves this robot"
                              : "the robot moved to another gateway just then",
           now);
  }
}

void SharedCommands::decide_alone(TimePoint now) {
  for (auto& waiting : turns_.take_all()) {
    const Duration age = now - waiting.came;
    if (waiting.is_refusal || age >= CommandTurns::kept_for) {
      refuse(waiting, "the gateways did not agree in time on who carries it out", now);
    } else {
      membership_.actions.push(CarryOut{std::move(waiting.message)});
    }
  }
}

CommandTurns::Choice SharedCommands::choose(const CommandTurns::Waiting& waiting,
                                            TimePoint now) const {
  using Choice = CommandTurns::Choice;
  const Duration age = now - waiting.came;
  const bool is_over = age >= CommandTurns::kept_for;
  if (!membership_.may_act(now)) return is_over ? Choice::forget : Choice::wait;
  // Of what came before this life heard the others it may have missed who took it.
  if (waiting.came < membership_.lease.joined() && membership_.peers.has_witness(waiting.came, now))
    return is_over ? Choice::forget : Choice::wait;
  if (claims_.is_held(waiting.robot))
    return age < CommandTurns::owner_patience ? Choice::take : Choice::refuse;
  const auto* row = membership_.table.find(waiting.robot);
  const bool has_owner =
      row && (membership_.is_mine(row->claim) || membership_.is_living(row->claim, now));
  const Duration patience = has_owner ? CommandTurns::last_patience : CommandTurns::owner_patience;
  if (age < patience) return Choice::wait;
  const int rank = rank_for(waiting.robot, now);
  const bool is_next = rank <= CommandTurns::max_refusal_turns &&
                       age >= patience + CommandTurns::refusal_turn * rank;
  if (is_next) return Choice::refuse;
  return is_over ? Choice::forget : Choice::wait;
}

bool SharedCommands::still_owns(const CommandTurns::Waiting& waiting, TimePoint now) const {
  const auto since = claims_.held_since(waiting.robot);
  return membership_.may_act(now) && since && *since <= waiting.taken;
}

/// Somebody has to speak for a robot that nobody serves: the living gateway of the greatest hash.
/// How many go before this one.
int SharedCommands::rank_for(const std::string& robot, TimePoint now) const {
  const std::uint64_t seed = fnv1a(robot + '\n');
  const std::uint64_t mine = fnv1a(membership_.me, seed);
  return static_cast<int>(std::ranges::count_if(membership_.peers.all(), [&](const auto& peer) {
    return now < peer.second.alive_until && fnv1a(peer.first, seed) > mine;
  }));
}

void SharedCommands::on_own_taken(const Taken& taken, const Now& now) {
  auto own = turns_.on_own_taken(
      taken.id, [&](const auto& waiting) { return still_owns(waiting, now.mono); }, now.mono);
  if (!own) return;
  if (own->said - own->came >= CommandTurns::owner_patience)
    return refuse(*own, "the broker took too long", now.mono);
  membership_.actions.push(CarryOut{std::move(own->message)});
}

void SharedCommands::on_taken(const std::string& gateway, Life life, const Taken& taken,
                              TimePoint now) {
  const auto answer = turns_.on_taken(
      gateway, life, taken, membership_.me,
      [&](const auto& waiting) { return still_owns(waiting, now); }, now);
  if (answer && membership_.lease.is_valid(now)) membership_.tell_all(*answer);
}

void SharedCommands::on_outcome(const std::string& gateway, const std::string& robot,
                                const std::string& type, TimePoint now) {
  if (gateway != membership_.me) turns_.on_outcome(gateway, robot, type, now);
}

/// Gateways tell it by turns: the first may have started too late to know of it.
CommandTurns::Fate SharedCommands::fate_of(const CommandTurns::Owed& owed, TimePoint now) const {
  using Fate = CommandTurns::Fate;
  constexpr std::chrono::seconds turn{2};
  constexpr int max_turns = 8;
  if (membership_.peers.is_alive(owed.gateway, owed.life, now)) return Fate::forget;
  if (!membership_.may_act(now)) return Fate::wait;
  const Peers::Peer* owner = membership_.peers.find(owed.gateway);
  if (owner && is_earlier_life(owed.life, owner->life) &&
      membership_.peers.is_alive(owed.gateway, now) &&
      owner->hears_since <= owed.came + back_in_time)
    return Fate::forget;
  const TimePoint due = owed.taken + CommandTurns::outcome_patience;
  const TimePoint back = membership_.lease.life_began();
  // What came while it was away may have come late, and behind its outcome.
  const bool may_have_missed = owed.taken < membership_.lease.joined();
  if (may_have_missed && membership_.peers.has_witness(owed.taken, now)) return Fate::forget;
  const int rank = rank_for(owed.robot, now);
  if (rank > max_turns) return Fate::forget;
  const bool was_away = back > owed.taken;
  const TimePoint mine = (was_away ? std::max(due, back + owner_returns) : due) + turn * rank;
  return now >= mine ? Fate::tell : Fate::wait;
}

void SharedCommands::end_overdue(TimePoint now) {
  const auto ask = [&](const CommandTurns::Owed& owed) { return fate_of(owed, now); };
  for (const auto& owed : turns_.take_overdue(ask, now)) {
    membership_.actions.push(EndCommand{owed.robot,
                                        owed.type,
                                        CommandResult::timeout,
                                        fmt::format("gateway '{}' took it and died", owed.gateway),
                                        {}});
  }
}

void SharedCommands::on_release(const std::string& gateway, Life life, const Release& release,
                                TimePoint now) {
  for (const DoneCommand& done : release.done)
    turns_.on_done(gateway, life, release.robot, done, now);
}

void SharedCommands::on_own_outcome(BrokerMessage outcome, Duration after, TimePoint now) {
  if (untold_.size() >= max_untold) {
    membership_.actions.push(TellOutcome{std::move(untold_.front().outcome)});
    untold_.pop_front();
  }
  untold_.push_back({std::move(outcome), now - after});
}

/// Outcomes that became due while this gateway was cut off are published by a gateway that was
/// connected all the time; if there is none, by this one. That is known once it has joined.
void SharedCommands::tell_outcomes(TimePoint now) {
  const bool is_alone = membership_.phase == Phase::alone;
  if (!is_alone && !membership_.lease.is_valid(now)) return;
  for (Untold& untold : std::exchange(untold_, {})) {
    const bool was_away = membership_.lease.joined() > untold.came + back_in_time;
    if (is_alone || !was_away) {
      membership_.actions.push(TellOutcome{std::move(untold.outcome)});
    } else if (membership_.phase != Phase::member) {
      untold_.push_back(std::move(untold));
    } else if (!membership_.peers.has_witness(untold.came, now)) {
      membership_.actions.push(TellOutcome{std::move(untold.outcome)});
    }
  }
}

void SharedCommands::tell_all_outcomes() {
  for (Untold& untold : std::exchange(untold_, {}))
    membership_.actions.push(TellOutcome{std::move(untold.outcome)});
}

}  // namespace slamgw::fleet
