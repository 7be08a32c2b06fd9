// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/shared_commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
namespace {

constexpr std::size_t max_untold = 65'536;       // as CommandLedger
constexpr std::chrono::seconds told_within{30};  // before CommandTurns::outcome_patience

}  // namespace

void SharedCommands::add(BrokerMessage message, std::string robot, std::string type,
                         const Now& now) {
  turns_.add(std::move(message), std::move(robot), std::move(type), now.mono);
  decide(now.mono);
}

void SharedCommands::decide(TimePoint now) {
  if (turns_.is_empty()) return;
  const auto said = turns_.decide(
      [&](const CommandTurns::Waiting& waiting) { return choose(waiting, now); }, now);
  for (const Taken& taken : said) context_.tell_all(taken);
  if (!context_.lease.is_valid(now)) return;
  for (const Taken& taken : turns_.repeat(now)) context_.tell_all(taken);
}

void SharedCommands::decide_alone(TimePoint now) {
  for (auto& waiting : turns_.take_all()) {
    const Duration age = now - waiting.came;
    if (waiting.is_refusal || age >= CommandTurns::kept_for) {
      context_.actions.push(EndCommand{waiting.robot, waiting.type, CommandResult::refused,
                                       "the gateways did not agree in time on who carries it out",
                                       age});
    } else {
      context_.actions.push(CarryOut{std::move(waiting.message)});
    }
  }
}

CommandTurns::Choice SharedCommands::choose(const CommandTurns::Waiting& waiting,
                                            TimePoint now) const {
  using Choice = CommandTurns::Choice;
  const Duration age = now - waiting.came;
  const bool is_over = age >= CommandTurns::kept_for;
  if (!context_.may_act(now)) return is_over ? Choice::forget : Choice::wait;
  if (claims_.is_held(waiting.robot))
    return age < CommandTurns::owner_patience ? Choice::take : Choice::refuse;
  const auto* row = context_.table.find(waiting.robot);
  const bool has_owner =
      row && (context_.is_mine(row->claim) || context_.is_living(row->claim, now));
  const Duration patience = has_owner ? CommandTurns::last_patience : CommandTurns::owner_patience;
  if (age >= patience && rank_for(waiting.robot, now) == 0) return Choice::refuse;
  return is_over ? Choice::forget : Choice::wait;
}

/// Somebody has to speak for a robot that nobody serves: the living gateway of the greatest hash.
/// How many go before this one.
int SharedCommands::rank_for(const std::string& robot, TimePoint now) const {
  const std::uint64_t seed = fnv1a(robot + '\n');
  const std::uint64_t mine = fnv1a(context_.me, seed);
  return static_cast<int>(std::ranges::count_if(context_.peers.all(), [&](const auto& peer) {
    return now < peer.second.alive_until && fnv1a(peer.first, seed) > mine;
  }));
}

void SharedCommands::on_own_taken(const Taken& taken, const Now& now) {
  auto own = turns_.on_own_taken(taken.id);
  if (!own) return;
  const auto end = [&](const char* why) {
    context_.actions.push(
        EndCommand{own->robot, own->type, CommandResult::refused, why, now.mono - own->came});
  };
  if (own->is_refusal) return end("no gateway serves this robot");
  if (!context_.may_act(now.mono) || !claims_.is_held(own->robot))
    return end("the robot moved to another gateway just then");
  context_.actions.push(CarryOut{std::move(own->message)});
}

void SharedCommands::on_taken(const std::string& gateway, Life life, const Taken& taken,
                              TimePoint now) {
  turns_.on_taken(gateway, life, taken, context_.me, now);
}

void SharedCommands::on_outcome(const std::string& gateway, const std::string& robot,
                                const std::string& type, TimePoint now) {
  if (gateway != context_.me) turns_.on_outcome(gateway, robot, type, now);
}

/// The first may have started too late to know of it: then the next tells the outcome.
void SharedCommands::end_overdue(TimePoint now) {
  using Fate = CommandTurns::Fate;
  constexpr std::chrono::seconds turn{2};
  constexpr int max_turns = 8;
  const auto fate_of = [&](const CommandTurns::Owed& owed) {
    if (context_.peers.is_alive(owed.gateway, owed.life, now)) return Fate::forget;
    if (!context_.lease.is_valid(now)) return Fate::wait;
    const int rank = rank_for(owed.robot, now);
    if (rank > max_turns) return Fate::forget;
    return now - owed.taken >= CommandTurns::outcome_patience + turn * rank ? Fate::tell
                                                                            : Fate::wait;
  };
  for (const auto& owed : turns_.take_overdue(fate_of, now)) {
    context_.actions.push(EndCommand{owed.robot,
                                     owed.type,
                                     CommandResult::timeout,
                                     fmt::format("gateway '{}' took it and died", owed.gateway),
                                     {}});
  }
}

void SharedCommands::on_own_outcome(BrokerMessage outcome, Duration after, TimePoint now) {
  if (untold_.size() >= max_untold) untold_.pop_front();
  untold_.push_back({std::move(outcome), now - after});
  tell_outcomes(now);
}

/// From a former life only as long as nobody else has told it.
void SharedCommands::tell_outcomes(TimePoint now) {
  const bool is_alone = context_.phase == Phase::alone;
  if (!is_alone && !context_.lease.is_valid(now)) return;
  for (Untold& untold : std::exchange(untold_, {})) {
    const bool is_too_late =
        untold.came < context_.lease.life_began() && now - untold.came >= told_within;
    if (is_alone || !is_too_late) context_.actions.push(TellOutcome{std::move(untold.outcome)});
  }
}

}  // namespace slamgw::fleet
