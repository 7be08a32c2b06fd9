// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/shared_commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/core/topic_scheme.hpp"
#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t max_unpublished = 65'536;  // as CommandLedger
/// Who would publish an overdue outcome in another gateway's place, and was cut off itself since
/// the command, hears the others for so long first: that gateway may come back and publish it.
constexpr std::chrono::seconds owner_returns{10};
/// A process that others hear again in a new life before its command is so old publishes the
/// outcome itself, or refuses what it had only said that it takes; it has not forgotten the
/// command.
constexpr std::chrono::seconds back_in_time{28};
/// Clocks and ways differ: near that time both it and the others publish the outcome, and the one
/// that asks later hears of the other.
constexpr std::chrono::seconds overlap{2};
/// So long it hears the others before it does that, but for fleets of more than 100 gateways.
constexpr std::chrono::seconds joins_within{4};
static_assert(TakenCommands::handed_on_for >
              back_in_time + joins_within + CommandTurns::refusal_settling);

/// What a broker has kept for a gateway comes so soon after the connection.
constexpr std::chrono::seconds kept_come_within{3};
/// A broker keeps a gateway's session for so long (MQTT 5, Session Expiry Interval).
constexpr std::chrono::minutes session_lasts{5};

}  // namespace

void SharedCommands::add(BrokerMessage message, std::string robot, std::string type, const Now& now,
                         bool may_be_copy) {
  if (may_be_copy && turns_.is_copy(message, now.mono)) return;
  if (turns_.take_missing_copy(message, claims_.is_held(robot), now.mono)) return;
  if (message.is_dup && turns_.is_known(message, now.mono)) return;
  const auto choose_now = [&](const auto& waiting) { return choose(waiting, now.mono); };
  for (const Taken& taken : turns_.add(std::move(message), std::move(robot), std::move(type),
                                       kept_before(now.mono), choose_now, now.mono))
    membership_.publish_to_all(taken);
  refuse_dropped(now.mono);
}

/// There was no room for them. Their owner says so, or who is alone.
void SharedCommands::refuse_dropped(TimePoint now) {
  for (auto& waiting : turns_.take_dropped()) {
    if (waiting.outcome) {
      membership_.actions.push(PublishOutcome{std::move(*waiting.outcome)});
      continue;
    }
    const bool is_owner = membership_.may_act(now) && claims_.is_held(waiting.robot);
    if (is_owner)
      membership_.publish_to_all(Taken{waiting.taking, waiting.key, waiting.robot, waiting.type});
    if (is_owner || membership_.phase == Phase::alone)
      refuse(waiting, "too many commands are on their way", now);
  }
}

void SharedCommands::refuse(const CommandTurns::Waiting& waiting, std::string why, TimePoint now) {
  EndCommand end{waiting.robot, waiting.type, CommandResult::refused, std::move(why),
                 now - waiting.came};
  if (!waiting.dead_owner.empty()) {
    end.result = CommandResult::timeout;
    end.why = fmt::format("gateway '{}' took it and died", waiting.dead_owner);
    end.after = {};
  }
  membership_.actions.push(std::move(end));
}

void SharedCommands::decide(TimePoint now) {
  if (turns_.is_empty()) return;
  const auto messages = turns_.decide(
      [&](const CommandTurns::Waiting& waiting) { return choose(waiting, now); }, now);
  for (const Taken& taken : messages) membership_.publish_to_all(taken);
  if (!membership_.lease.is_valid(now)) return;
  const auto owns = [&](const CommandTurns::Waiting& waiting) { return still_owns(waiting, now); };
  for (const Taken& taken : turns_.repeat(owns, now)) membership_.publish_to_all(taken);
  for (auto& waiting : turns_.take_refused(now)) {
    if (waiting.outcome) {
      publish({std::move(*waiting.outcome), now, waiting.robot, waiting.type});
      continue;
    }
    refuse(waiting,
           waiting.has_moved ? "the robot moved to another gateway just then"
                             : "no gateway serves this robot",
           now);
  }
}

void SharedCommands::carry_out(CommandTurns::Waiting waiting, TimePoint now) {
  waiting.message.waited = std::chrono::duration_cast<Waited>(now - waiting.came);
  membership_.actions.push(CarryOut{std::move(waiting.message)});
}

void SharedCommands::decide_alone(TimePoint now) {
  for (auto& waiting : turns_.take_all()) {
    const Duration age = now - waiting.came;
    if (waiting.outcome) {
      membership_.actions.push(PublishOutcome{std::move(*waiting.outcome)});
    } else if (waiting.is_refusal || age >= CommandTurns::kept_for) {
      refuse(waiting, "the gateways did not agree in time on who carries it out", now);
    } else {
      carry_out(std::move(waiting), now);
    }
  }
}

CommandTurns::Choice SharedCommands::choose(const CommandTurns::Waiting& waiting,
                                            TimePoint now) const {
  using Choice = CommandTurns::Choice;
  const Duration age = now - waiting.came;
  if (!membership_.may_act(now))
    return waiting.was_taken || age < TakenCommands::kept_for ? Choice::wait : Choice::forget;
  if (waiting.was_taken && is_left_to_others(waiting.came, now)) return Choice::forget;
  if (waiting.outcome || !waiting.dead_owner.empty()) return Choice::refuse;
  // Witnesses have dealt with it when its time is over, or have left it to this gateway, which said
  // that it took it.
  const Knower knower = who_knows_of(waiting.came, Gaps::none, now);
  if (waiting.was_taken && (knower == Knower::witnesses || !claims_.is_held(waiting.robot)))
    return Choice::refuse;
  if (knower == Knower::witnesses)
    return age < CommandTurns::last_patience ? Choice::wait : Choice::forget;
  if (knower == Knower::taker && may_taker_return(waiting.came, now)) return Choice::wait;
  // Another gateway may have taken it, unheard here.
  const bool was_unheard = waiting.kept > Duration::zero() && waiting.came < unheard_until_;
  if (claims_.is_held(waiting.robot))
    return age < CommandTurns::owner_patience && !was_unheard ? Choice::take : Choice::refuse;
  return choose_for_nobody(waiting, now);
}

/// The robot is not this gateway's. If its owner does not take the command, the gateways refuse it
/// by turns.
CommandTurns::Choice SharedCommands::choose_for_nobody(const CommandTurns::Waiting& waiting,
                                                       TimePoint now) const {
  using Choice = CommandTurns::Choice;
  const Duration age = now - waiting.came;
  const auto row = membership_.table.find(waiting.robot);
  const bool has_owner =
      row && (membership_.is_mine(row->claim) || membership_.is_living(row->claim, now));
  const Duration patience = has_owner ? CommandTurns::last_patience : CommandTurns::owner_patience;
  if (age < patience) return Choice::wait;
  const int rank = rank_for(waiting.robot, TimePoint::max(), now);
  const bool is_next = rank <= CommandTurns::max_refusal_turns &&
                       age >= patience + CommandTurns::refusal_turn * rank;
  if (is_next) return Choice::refuse;
  return age < CommandTurns::kept_for ? Choice::wait : Choice::forget;
}

/// A gateway that was there when the command came may have dealt with it, and was cut off as this
/// one was.
bool SharedCommands::may_taker_return(TimePoint came, TimePoint now) const {
  return now < membership_.lease.joined() + owner_returns &&
         std::ranges::any_of(membership_.peers.all(), [&](const auto& each) {
           const TimePoint alive_until = each.second.alive_until;
           return came < alive_until && alive_until <= now;
         });
}

bool SharedCommands::still_owns(const CommandTurns::Waiting& waiting, TimePoint now) const {
  const auto since = claims_.held_since(waiting.robot);
  return membership_.may_act(now) && since && *since <= waiting.taken;
}

/// Somebody has to speak for a robot that nobody serves: the living gateway of the greatest hash.
/// How many go before this one, of those that hear the others since then.
int SharedCommands::rank_for(const std::string& robot, TimePoint since, TimePoint now) const {
  const std::uint64_t seed = fnv1a(robot + '\n');
  const std::uint64_t mine = fnv1a(membership_.me, seed);
  return static_cast<int>(std::ranges::count_if(membership_.peers.all(), [&](const auto& peer) {
    return now < peer.second.alive_until && peer.second.hears_since <= since &&
           fnv1a(peer.first, seed) > mine;
  }));
}

void SharedCommands::on_own_taken(const Taken& taken, const Now& now) {
  auto own = turns_.on_own_taken(
      taken, [&](const auto& waiting) { return still_owns(waiting, now.mono); }, now.mono);
  if (!own) return;
  if (own->last_sent - own->came >= CommandTurns::owner_patience)
    return refuse(*own, "the broker took too long", now.mono);
  carry_out(std::move(*own), now.mono);
}

void SharedCommands::on_taken(const std::string& gateway, Life life, Taken taken, TimePoint now) {
  taken.age_ms += to_age_ms(membership_.peers.delay_of(gateway, life, taken.sent_ms, now));
  // Not all answer at once that know the outcome of what one wants to refuse.
  constexpr int speakers = 3;
  std::optional<bool> speaks;  // one search among many equal commands asks once
  const auto objects = [&](const TakenCommands::Entry& known) {
    if (known.is_own()) return known.is_ended || !may_be_left_to_others(known.came, now);
    if (!known.is_ended || known.gateway == gateway) return false;
    if (!speaks) speaks = rank_for(known.robot, TimePoint::max(), now) < speakers;
    return *speaks;
  };
  const auto row = membership_.table.find(taken.robot);
  const bool is_owner = row && row->claim.gateway == gateway && row->claim.life == life;
  const auto answer = turns_.on_taken(
      {gateway, life, is_owner}, taken, membership_.me,
      [&](const auto& waiting) { return still_owns(waiting, now); }, objects, now);
  // That an outcome is published stays true whether this gateway takes part or not.
  if (answer && (answer->is_ended || membership_.lease.is_valid(now)))
    membership_.publish_to_all(*answer);
}

void SharedCommands::on_outcome(const std::string& gateway, const std::string& robot,
                                const std::string& type, Duration after, TimePoint now) {
  if (gateway != membership_.me) turns_.on_outcome(gateway, robot, type, now - after, now);
}

bool SharedCommands::is_heard_again(const BrokerMessage& outcome, TimePoint now) {
  const auto is_old = [&](const auto& each) {
    return now - each.second > CommandTurns::delivered_again_for;
  };
  auto& heard = heard_outcomes_;
  while (!heard.empty() && (is_old(heard.front()) || heard.size() >= max_unpublished))
    heard.pop_front();
  const std::uint64_t words = CommandTurns::key_of(outcome);
  const auto is_same = [&](const auto& each) { return each.first == words; };
  if (outcome.is_dup && std::ranges::any_of(heard, is_same)) return true;
  heard.emplace_back(words, now);
  return false;
}

/// Gateways publish it by turns: the first may have missed that it is to.
CommandTurns::Fate SharedCommands::fate_of(const TakenCommands::Entry& owed, TimePoint now) const {
  using Fate = CommandTurns::Fate;
  constexpr std::chrono::seconds turn{2};
  constexpr int max_turns = 8;
  const TimePoint latest = owed.taken + CommandTurns::outcome_patience;
  if (now >= latest && membership_.peers.is_alive(owed.gateway, owed.life, now))
    return Fate::forget;
  if (!membership_.may_act(now)) return Fate::wait;
  // What came while this gateway was away may have come late, and behind its outcome. A witness
  // need not be there any more when the outcome is due.
  const Knower knower = who_knows_of(owed.came, Gaps::short_ones, now);
  if (knower == Knower::witnesses) return Fate::forget;
  const bool has_heard = knower == Knower::this_gateway;
  const Peers::Peer* owner = membership_.peers.find(owed.gateway);
  const bool is_back = owner && is_earlier_life(owed.life, owner->life) &&
                       membership_.peers.is_alive(owed.gateway, now);
  // It leaves the outcome to this gateway, which may be cut off itself until the latest time.
  const bool is_left_here =
      is_back && has_heard && owner->hears_since > owed.came + back_in_time + overlap;
  const TimePoint due = is_left_here ? std::min(latest, owner->hears_since) : latest;
  if (now < due) return Fate::wait;
  if (is_back && owner->hears_since <= owed.came + back_in_time) return Fate::forget;
  // Without a witness the process that took it publishes the outcome, however late.
  if (!has_heard && is_back) return Fate::forget;
  const int rank = rank_for(owed.robot, has_heard ? owed.came : TimePoint::max(), now);
  if (rank > max_turns) return Fate::forget;
  const TimePoint earliest =
      heard_others(owed.taken) ? due : std::max(due, membership_.lease.joined() + owner_returns);
  const TimePoint mine = earliest + turn * rank;
  return now >= mine ? Fate::end : Fate::wait;
}

void SharedCommands::end_overdue(TimePoint now) {
  turns_.add_overdue([&](const TakenCommands::Entry& owed) { return fate_of(owed, now); }, now);
}

void SharedCommands::on_release(const std::string& gateway, Life life, const Release& release,
                                TimePoint now) {
  const auto delay_ms = to_age_ms(membership_.peers.delay_of(gateway, life, release.sent_ms, now));
  for (DoneCommand done : release.done) {
    done.age_ms += delay_ms;
    turns_.on_done(gateway, life, release.robot, done, now);
  }
}

void SharedCommands::on_own_outcome(BrokerMessage outcome, Duration after, TimePoint now) {
  if (unpublished_.size() >= max_unpublished) {
    membership_.actions.push(PublishOutcome{std::move(unpublished_.front().outcome)});
    unpublished_.pop_front();
  }
  const auto of = membership_.topics.outcome(outcome.topic);
  std::string robot(of ? of->robot : std::string_view{});
  const auto known = read(outcome);
  unpublished_.push_back(
      {std::move(outcome), now - after, std::move(robot), known ? known->type : std::string{}});
}

/// The outcome of what this gateway took then became due while it was cut off: a gateway that was
/// connected all the time publishes it; if there is none, this one. That is known once it has
/// joined.
bool SharedCommands::is_left_to_others(TimePoint came, TimePoint now) const {
  return was_away_since(came) && who_knows_of(came, Gaps::short_ones, now) == Knower::witnesses;
}

/// While this gateway joins, who was connected all the time is still to be heard.
bool SharedCommands::may_be_left_to_others(TimePoint came, TimePoint now) const {
  const bool is_known = membership_.phase == Phase::member;
  return is_known ? is_left_to_others(came, now) : was_away_since(came);
}

SharedCommands::Knower SharedCommands::who_knows_of(TimePoint came, Gaps gaps,
                                                    TimePoint now) const {
  if (heard_others(came)) return Knower::this_gateway;
  const bool has_witness = gaps == Gaps::none ? membership_.peers.has_gapless_witness(came, now)
                                              : membership_.peers.has_witness(came, now);
  return has_witness ? Knower::witnesses : Knower::taker;
}

bool SharedCommands::heard_others(TimePoint time) const {
  return time >= membership_.lease.joined();
}

bool SharedCommands::was_away_since(TimePoint came) const {
  return membership_.lease.joined() > came + back_in_time + overlap;
}

void SharedCommands::publish_outcomes(TimePoint now) {
  const bool is_alone = membership_.phase == Phase::alone;
  if (!is_alone && !membership_.lease.is_valid(now)) return;
  for (Unpublished& unpublished : std::exchange(unpublished_, {})) {
    if (is_alone) {
      membership_.actions.push(PublishOutcome{std::move(unpublished.outcome)});
    } else if (is_of_this_life(unpublished)) {
      publish(std::move(unpublished));
    } else if (membership_.phase == Phase::member) {
      settle(std::move(unpublished), now);
    } else {
      unpublished_.push_back(std::move(unpublished));
    }
  }
}

/// It may have come before, and have been carried out in this life.
bool SharedCommands::is_of_this_life(const Unpublished& unpublished) const {
  const auto& [outcome, came, robot, type] = unpublished;
  const TimePoint life_began = membership_.lease.life_began();
  if (came >= life_began) return true;
  const auto* own = membership_.commands.find_own(robot, type, came);
  return own && own->taken >= life_began;
}

/// An outcome from before this life. Others may publish it in this gateway's place, or have
/// published it, unless they have just agreed that this gateway refuses the command.
void SharedCommands::settle(Unpublished unpublished, TimePoint now) {
  const auto& [outcome, came, robot, type] = unpublished;
  const bool is_agreed = membership_.commands.has_ended(robot, type, came);
  if (!is_agreed && is_left_to_others(came, now)) return;
  // An earlier process took it, and this one does not know which command it was.
  if (is_agreed || !turns_.add_outcome(outcome, robot, type, came)) publish(std::move(unpublished));
}

/// At the broker, while this gateway's life lasts.
void SharedCommands::publish(Unpublished unpublished) {
  membership_.actions.push(PublishOutcomeNow{++last_published_, unpublished.outcome});
  unacknowledged_.emplace(last_published_, std::move(unpublished));
}

std::optional<SharedCommands::Outcome> SharedCommands::read(const BrokerMessage& outcome) {
  constexpr std::uint64_t longest_ms = 3'600'000;
  const auto json =
      nlohmann::json::parse(outcome.payload.begin(), outcome.payload.end(), nullptr, false);
  if (!json.is_object() || !json.contains("type") || !json["type"].is_string()) return std::nullopt;
  Outcome read{json["type"].get<std::string>(), {}};
  if (!is_valid_level(read.type)) return std::nullopt;
  if (json.contains("after_ms") && json["after_ms"].is_number_unsigned())
    read.after =
        std::chrono::milliseconds(std::min(json["after_ms"].get<std::uint64_t>(), longest_ms));
  return read;
}

void SharedCommands::on_outcome_acknowledged(std::uint64_t id) {
  const auto published = unacknowledged_.extract(id);
  if (!published) return;
  const Unpublished& known = published.mapped();
  membership_.commands.end_of({}, known.robot, known.type, known.came);
}

void SharedCommands::on_outcome_refused(std::uint64_t id) {
  if (auto published = unacknowledged_.extract(id))
    membership_.actions.push(PublishOutcome{std::move(published.mapped().outcome)});
}

void SharedCommands::on_link_up(bool is_session_kept, TimePoint now) {
  is_session_kept_ = is_session_kept;
  link_up_ = now;
  are_others_kept_ = are_others_kept_ && is_session_kept;
  if (is_session_kept && !are_others_kept_) unheard_until_ = now + kept_come_within;
}

Duration SharedCommands::kept_before(TimePoint now) const {
  if (!is_session_kept_ || now - link_up_ > kept_come_within) return {};
  return link_lost_ ? now - *link_lost_ : session_lasts;
}

/// On a connection that lasted too short the broker may not have sent what it had kept.
void SharedCommands::on_link_lost(TimePoint now, bool has_heard_others) {
  are_others_kept_ = are_others_kept_ || has_heard_others;
  if (now - link_up_ > kept_come_within) link_lost_ = now;
  for (auto& [id, outcome] : std::exchange(unacknowledged_, {}))
    unpublished_.push_back(std::move(outcome));
}

void SharedCommands::publish_all_outcomes() {
  for (Unpublished& unpublished : std::exchange(unpublished_, {}))
    membership_.actions.push(PublishOutcome{std::move(unpublished.outcome)});
  for (BrokerMessage& outcome : turns_.take_outcomes())
    membership_.actions.push(PublishOutcome{std::move(outcome)});
}

}  // namespace slamgw::fleet
