// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/command_turns.hpp"

#include <algorithm>
#include <utility>

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
std::uint64_t CommandTurns::key_of(const BrokerMessage& command) {
  return fnv1a(as_text(command.payload), fnv1a(command.topic + '\n'));
}

Taken CommandTurns::to_taken(const Waiting& waiting, TimePoint now) {
  return {waiting.taking,
          waiting.key,
          waiting.robot,
          waiting.type,
          to_age_ms(now - waiting.came),
          waiting.is_refusal,
          false,
          to_clock_ms(now),
          to_age_ms(waiting.kept)};
}

std::vector<Taken> CommandTurns::add(BrokerMessage message, std::string robot, std::string type,
                                     Duration kept, const Choose& choose, TimePoint now) {
  Waiting waiting;
  waiting_octets_ += message.payload.size();
  waiting.message = std::move(message);
  waiting.robot = std::move(robot);
  waiting.type = std::move(type);
  waiting.key = key_of(waiting.message);
  waiting.came = now - waiting.message.waited;
  waiting.kept = kept;
  std::vector<Taken> messages;
  decide_one(insert(std::move(waiting)), choose, now, messages);
  make_room();
  return messages;
}

std::map<CommandTurns::Number, CommandTurns::Waiting>::iterator CommandTurns::insert(
    Waiting waiting) {
  by_key_[waiting.key].insert(++last_number_);
  return waiting_.emplace(last_number_, std::move(waiting)).first;
}

bool CommandTurns::add_outcome(const BrokerMessage& outcome, const std::string& robot,
                               const std::string& type, TimePoint came) {
  const auto* done = commands_.find_own(robot, type, came);
  if (!done) return false;
  Waiting waiting;
  waiting.outcome = outcome;
  waiting.robot = robot;
  waiting.type = type;
  waiting.key = done->command.key;
  waiting.came = done->came;
  waiting.kept = done->kept;
  waiting.was_taken = true;
  insert(std::move(waiting));
  make_room();
  return true;
}

bool CommandTurns::is_copy(const BrokerMessage& command, TimePoint now) {
  if (firsts_.size() >= max_waiting) firsts_.clear();
  const auto [first, is_first] = firsts_.try_emplace(key_of(command), now);
  if (is_first) return false;
  const bool is_copy = now - first->second < TakenCommands::heard_apart;
  if (is_copy) {
    firsts_.erase(first);
  } else {
    first->second = now;
  }
  return is_copy;
}

bool CommandTurns::take_missing_copy(const BrokerMessage& command, bool is_owner, TimePoint now) {
  return commands_.take_missing_copy(key_of(command), is_owner, now);
}

bool CommandTurns::is_known(const BrokerMessage& command, TimePoint now) const {
  const std::uint64_t key = key_of(command);
  return by_key_.contains(key) || commands_.find(key, [&](const TakenCommands::Entry& entry) {
    return now - entry.came <= delivered_again_for;
  });
}

void CommandTurns::make_room() {
  while (waiting_.size() > max_waiting || waiting_octets_ > max_waiting_octets) {
    ++dropped_;
    dropped_now_.push_back(remove(waiting_.begin()));
    if (dropped_now_.back().taking == 0) dropped_now_.back().taking = ++last_id_;
  }
}

CommandTurns::Waiting CommandTurns::remove(std::map<Number, Waiting>::iterator each) {
  Waiting removed = std::move(each->second);
  waiting_octets_ -= removed.message.payload.size();
  taking_.erase(removed.taking);
  const auto equal = by_key_.find(removed.key);
  equal->second.erase(each->first);
  if (equal->second.empty()) by_key_.erase(equal);
  waiting_.erase(each);
  return removed;
}

std::vector<Taken> CommandTurns::decide(const Choose& choose, TimePoint now) {
  std::vector<Taken> messages;
  for (auto each = waiting_.begin(); each != waiting_.end();)
    decide_one(each++, choose, now, messages);
  return messages;
}

void CommandTurns::decide_one(std::map<Number, Waiting>::iterator each, const Choose& choose,
                              TimePoint now, std::vector<Taken>& messages) {
  Waiting& waiting = each->second;
  if (waiting.taking != 0) return;
  const Choice choice = choose(waiting);
  if (choice == Choice::forget) remove(each);
  if (choice == Choice::take || choice == Choice::refuse)
    begin_taking(each, choice == Choice::refuse, now, messages);
}

/// Under a new id.
void CommandTurns::begin_taking(std::map<Number, Waiting>::iterator each, bool is_refusal,
                                TimePoint now, std::vector<Taken>& messages) {
  Waiting& waiting = each->second;
  waiting.taking = ++last_id_;
  taking_[waiting.taking] = each->first;
  waiting.is_refusal = is_refusal;
  waiting.taken = waiting.last_sent = now;
  waiting.copies = 1;
  waiting.has_moved = false;
  waiting.contested.reset();
  waiting.settles.reset();
  messages.push_back(to_taken(waiting, now));
}

/// Under the same id: who has heard that this gateway takes it has forgotten its own copy.
void CommandTurns::turn_to_refusal(Waiting& waiting, TimePoint now, std::vector<Taken>& messages) {
  waiting.is_refusal = true;
  waiting.last_sent = now;
  waiting.copies = 1;
  waiting.contested.reset();
  messages.push_back(to_taken(waiting, now));
}

/// Under the same id: others know it already if it was only the echo that was lost. A refusal is
/// sent more than once in any case: who would object may have missed it.
std::vector<Taken> CommandTurns::repeat(const StillOwns& still_owns, TimePoint now) {
  std::vector<Taken> messages;
  for (const auto& [id, number] : taking_) {
    Waiting& waiting = waiting_.at(number);
    if (!waiting.is_refusal && !still_owns(waiting)) {
      waiting.has_moved = true;
      turn_to_refusal(waiting, now, messages);
      continue;
    }
    if (waiting.contested && !waiting.settles) {
      if (now - *waiting.contested < contest_patience) continue;
      waiting.contested.reset();
      if (!waiting.is_refusal) {
        turn_to_refusal(waiting, now, messages);
        continue;
      }
    }
    const bool is_enough = waiting.settles && waiting.copies >= refusal_copies;
    if (is_enough || now - waiting.last_sent < repeat_interval) continue;
    waiting.last_sent = now;
    ++waiting.copies;
    messages.push_back(to_taken(waiting, now));
  }
  return messages;
}

/// True when there is an equal command here. Of two gateways that take one, both see in the same
/// way who must yield: who only refuses it, who has lost the robot to the other one, or else the
/// greater id. Who has lost it to a third one does not know whether the other one has, too: it
/// turns to a refusal (repeat).
bool CommandTurns::cancel(const Taker& taker, const Taken& taken, const std::string& own_gateway,
                          const StillOwns& still_owns, TimePoint now) {
  const auto equal = by_key_.find(taken.key);
  if (equal == by_key_.end()) return false;
  const auto is_idle = [&](Number number) { return waiting_.at(number).taking == 0; };
  const auto idle = std::ranges::find_if(equal->second, is_idle);
  const auto each = waiting_.find(idle != equal->second.end() ? *idle : *equal->second.begin());
  Waiting& mine = each->second;
  const bool is_refusal = taken.is_refusal;
  // The other one yields to a refusal that this gateway has said in a former life, which may come
  // out late.
  const bool is_yielded_to =
      mine.was_taken && mine.is_refusal && is_refusal && own_gateway < taker.gateway;
  bool must_yield = (mine.taking == 0 && !is_yielded_to) || (mine.is_refusal && !is_refusal);
  if (!must_yield && mine.taking != 0 && mine.is_refusal == is_refusal)
    must_yield = is_refusal ? taker.gateway < own_gateway : taker.is_owner && !still_owns(mine);
  if (must_yield) {
    remove(each);
  } else if (mine.taking != 0 && !mine.settles && !mine.contested) {
    mine.contested = now;
  }
  return true;
}

std::optional<Taken> CommandTurns::on_taken(const Taker& taker, const Taken& taken,
                                            const std::string& own_gateway,
                                            const StillOwns& still_owns,
                                            const TakenCommands::Matches& objects, TimePoint now) {
  const auto& [gateway, life, is_owner] = taker;
  settle_early_outcomes(now);
  if (auto objection = answer(taken, objects, now)) return objection;
  const TimePoint came = came_before(now, taken.age_ms);
  // Gateways that wanted to refuse it yield, and owe nothing.
  const auto yields = [&](const TakenCommands::Entry& entry) {
    return entry.is_refusal && entry.gateway != gateway && entry.is_copy(taken.key, came);
  };
  if (!taken.is_refusal) commands_.forget_owed(yields);
  if (taken.is_ended) commands_.end(taken.key, came);
  const auto is_same = [&](const TakenCommands::Entry& entry) {
    return entry.command.id == taken.id && entry.is_of(gateway, life);
  };
  if (commands_.find(taken.key, is_same)) {  // the broker's copy, or said again
    if (taken.is_refusal) commands_.turn_to_refusal(taken.key, is_same);
    if (!taken.is_refusal || gateway < own_gateway) yield_refusal(taken, now);
    return std::nullopt;
  }
  // Another gateway has taken it before, and this one's copy was cancelled then.
  const auto is_known = [&](const TakenCommands::Entry& entry) {
    return entry.is_copy(taken.key, came) && !entry.is_of(gateway, life);
  };
  const bool is_again = commands_.find(taken.key, is_known) && !has_copy(taken.key, came) &&
                        !(taken.is_refusal && is_refusing(taken.key));
  if (!taken.is_ended) forget_former_life(gateway, life, taken.key, came, now);
  const auto early = taken.is_ended ? std::nullopt : take_early_outcome(gateway, taken, came);
  TakenCommands::Entry entry{taken.robot, {taken.id, taken.key, taken.type}, came, gateway, life};
  entry.taken = now;
  entry.kept = kept_before(taken);
  entry.is_refusal = taken.is_refusal;
  entry.is_ended = taken.is_ended || (early && entry.has_begun(early->began));
  entry.is_copy_missing = !is_again && !cancel(taker, taken, own_gateway, still_owns, now);
  commands_.add(std::move(entry), !taken.is_ended && !early, now);
  return std::nullopt;
}

/// As a command that is carried out, so that the other one yields.
std::optional<Taken> CommandTurns::answer(const Taken& taken, const TakenCommands::Matches& objects,
                                          TimePoint now) const {
  if (!taken.is_refusal) return std::nullopt;
  const TakenCommands::Arrival theirs{came_before(now, taken.age_ms), kept_before(taken)};
  const auto* known = commands_.find(taken.key, [&](const TakenCommands::Entry& entry) {
    return entry.arrival().may_be_with(theirs) && objects(entry);
  });
  if (!known) return std::nullopt;
  const DoneCommand& command = known->command;
  return Taken{command.id,
               command.key,
               known->robot,
               command.type,
               to_age_ms(now - known->came),
               false,
               known->is_ended,
               to_clock_ms(now),
               to_age_ms(known->kept)};
}

void CommandTurns::on_done(const std::string& gateway, Life life, const std::string& robot,
                           const DoneCommand& done, TimePoint now) {
  const TimePoint came = came_before(now, done.age_ms);
  // Under the id that its taker gave it, also when others have handed it on.
  const bool is_same = commands_.find(done.key, [&](const TakenCommands::Entry& entry) {
    return entry.command.id == done.id &&
           (entry.is_of(gateway, life) || entry.is_copy(done.key, came));
  });
  if (is_same) return;
  const bool is_known = commands_.find(
      done.key, [&](const TakenCommands::Entry& entry) { return entry.is_copy(done.key, came); });
  const bool is_here = remove_one(done.key, [&](const Waiting& waiting) {
    return waiting.taking == 0 && TakenCommands::came_together(waiting.came, came);
  });
  TakenCommands::Entry entry{robot, {done.id, done.key, done.type}, came, gateway, life};
  entry.is_copy_missing = !is_here && !is_known;
  commands_.add(std::move(entry), false, now);
}

/// A gateway that takes a command again in a new life owes one outcome. After a restart it has got
/// the command from the broker once more, as if it were new.
void CommandTurns::forget_former_life(const std::string& gateway, Life life, std::uint64_t key,
                                      TimePoint came, TimePoint now) {
  bool is_found = false;
  commands_.forget_owed([&](const TakenCommands::Entry& entry) {
    const bool is_former =
        entry.gateway == gateway && entry.life != life && entry.command.key == key &&
        (TakenCommands::came_together(entry.came, came) || now - entry.taken < kept_for);
    return is_former && !std::exchange(is_found, true);
  });
}

/// An equal command that came then waits here.
bool CommandTurns::has_copy(std::uint64_t key, TimePoint came) const {
  const auto equal = by_key_.find(key);
  return equal != by_key_.end() && std::ranges::any_of(equal->second, [&](Number number) {
           return TakenCommands::came_together(waiting_.at(number).came, came);
         });
}

/// A broker that kept a command while all were cut off delivers it to each when that one is back,
/// so that it seems to have come at another time.
bool CommandTurns::is_refusing(std::uint64_t key) const {
  const auto equal = by_key_.find(key);
  return equal != by_key_.end() && std::ranges::any_of(equal->second, [&](Number number) {
           const Waiting& waiting = waiting_.at(number);
           return waiting.taking != 0 && waiting.is_refusal;
         });
}

/// Who has taken a command objects to this gateway's refusal by saying so again. Of two gateways
/// that refuse what both had taken the one of the lesser name goes on.
void CommandTurns::yield_refusal(const Taken& taken, TimePoint now) {
  const TakenCommands::Arrival theirs{came_before(now, taken.age_ms), kept_before(taken)};
  remove_one(taken.key, [&](const Waiting& waiting) {
    return waiting.is_refusal && theirs.may_be_with({waiting.came, waiting.kept});
  });
}

/// The first equal command that waits and is meant.
bool CommandTurns::remove_one(std::uint64_t key,
                              const std::function<bool(const Waiting&)>& is_meant) {
  const auto equal = by_key_.find(key);
  if (equal == by_key_.end()) return false;
  const auto found = std::ranges::find_if(
      equal->second, [&](Number number) { return is_meant(waiting_.at(number)); });
  if (found == equal->second.end()) return false;
  remove(waiting_.find(*found));
  return true;
}

std::optional<CommandTurns::Waiting> CommandTurns::on_own_taken(const Taken& taken,
                                                                const StillOwns& still_owns,
                                                                TimePoint now) {
  const auto number = taking_.find(taken.id);
  if (number == taking_.end()) return std::nullopt;
  const auto each = waiting_.find(number->second);
  Waiting& waiting = each->second;
  if (waiting.is_refusal != taken.is_refusal) return std::nullopt;  // what it said before
  if (!waiting.is_refusal && still_owns(waiting)) return finish(each, false, now);
  if (waiting.is_refusal && !waiting.settles) waiting.settles = now + refusal_settling;
  return std::nullopt;  // repeat() turns one whose robot is lost to a refusal
}

std::vector<CommandTurns::Waiting> CommandTurns::take_refused(TimePoint now) {
  std::vector<Waiting> refused;
  for (const auto& [id, number] : std::map(taking_)) {
    const auto each = waiting_.find(number);
    const auto& settles = each->second.settles;
    if (settles && now >= *settles) refused.push_back(finish(each, true, now));
  }
  return refused;
}

CommandTurns::Waiting CommandTurns::finish(std::map<Number, Waiting>::iterator each, bool is_ended,
                                           TimePoint now) {
  Waiting finished = remove(each);
  TakenCommands::Entry mine{
      finished.robot, {finished.taking, finished.key, finished.type}, finished.came};
  mine.is_ended = is_ended;
  mine.kept = finished.kept;
  if (is_ended) commands_.end(finished.key, finished.came);
  commands_.add(std::move(mine), false, now);
  return finished;
}

std::vector<CommandTurns::Waiting> CommandTurns::take_all() {
  std::vector<Waiting> all;
  for (auto& [number, waiting] : waiting_) all.push_back(std::move(waiting));
  waiting_.clear();
  by_key_.clear();
  taking_.clear();
  waiting_octets_ = 0;
  return all;
}

std::vector<BrokerMessage> CommandTurns::take_outcomes() {
  std::vector<BrokerMessage> outcomes;
  for (auto each = waiting_.begin(); each != waiting_.end();) {
    const auto next = std::next(each);
    if (each->second.outcome) outcomes.push_back(std::move(*remove(each).outcome));
    each = next;
  }
  return outcomes;
}

void CommandTurns::on_new_life() {
  firsts_.clear();
  taking_.clear();
  // Their outcomes are owed still: the new life decides anew.
  for (auto each = waiting_.begin(); each != waiting_.end();) {
    const auto next = std::next(each);
    if (!each->second.dead_owner.empty()) remove(each);
    each = next;
  }
  for (auto& [number, waiting] : waiting_)
    waiting.was_taken |= std::exchange(waiting.taking, 0) != 0;
}

void CommandTurns::on_outcome(const std::string& gateway, const std::string& robot,
                              const std::string& type, TimePoint began, TimePoint now) {
  using Entry = TakenCommands::Entry;
  const auto is_meant = [&](const Entry& owed) {
    return owed.robot == robot && owed.command.type == type;
  };
  const auto is_certain = [&](const Entry& owed) {
    return owed.gateway == gateway && is_meant(owed) && owed.has_begun(began);
  };
  const auto is_in_place = [&](const Entry& owed) {
    return owed.gateway != gateway && now - owed.came >= in_place_after && is_meant(owed);
  };
  if (const Entry* owed = commands_.find_owed(is_certain, began))
    return commands_.end(owed->command.key, owed->came);
  if (const Entry* in_place = commands_.find_owed(is_in_place))
    return forget_owed(in_place->command.key, in_place->came);
  if (commands_.end_of(gateway, robot, type, began)) return;  // its outcome was left to others
  settle_early_outcomes(now);
  early_outcomes_.push_back({gateway, robot, type, began, now});
  if (early_outcomes_.size() > max_early_outcomes) early_outcomes_.pop_front();
}

/// Those whose `Taken` has not come. A slow broker may bring an outcome much later than its time
/// says: then it is of the oldest command that the gateway has taken.
void CommandTurns::settle_early_outcomes(TimePoint now) {
  while (!early_outcomes_.empty() && now - early_outcomes_.front().came > early_kept_for) {
    const EarlyOutcome late = std::move(early_outcomes_.front());
    early_outcomes_.pop_front();
    const auto fits = [&](const TakenCommands::Entry& entry) {
      return entry.gateway == late.gateway && entry.robot == late.robot &&
             entry.command.type == late.type &&
             entry.came <= late.came + TakenCommands::heard_apart;
    };
    const auto* owed = commands_.find_owed(fits);
    if (!owed) continue;
    // If it may be of another one, nobody may object that this one has its outcome.
    if (commands_.find_owed([&](const auto& entry) { return &entry != owed && fits(entry); }))
      forget_owed(owed->command.key, owed->came);
    else
      commands_.end(owed->command.key, owed->came);
  }
}

void CommandTurns::forget_owed(std::uint64_t key, TimePoint came) {
  commands_.forget_owed(
      [&](const TakenCommands::Entry& entry) { return entry.is_copy(key, came); });
}

/// One that was heard before the command came is of another command.
std::optional<CommandTurns::EarlyOutcome> CommandTurns::take_early_outcome(
    const std::string& gateway, const Taken& taken, TimePoint came) {
  const auto early = std::ranges::find_if(early_outcomes_, [&](const EarlyOutcome& outcome) {
    return outcome.gateway == gateway && outcome.robot == taken.robot &&
           outcome.type == taken.type && came <= outcome.came + TakenCommands::heard_apart;
  });
  if (early == early_outcomes_.end()) return std::nullopt;
  EarlyOutcome taken_out = std::move(*early);
  early_outcomes_.erase(early);
  return taken_out;
}

void CommandTurns::add_overdue(const std::function<Fate(const TakenCommands::Entry&)>& fate_of,
                               TimePoint now) {
  settle_early_outcomes(now);
  std::vector<TakenCommands::Entry> overdue;
  commands_.forget_owed([&](const TakenCommands::Entry& owed) {
    const bool is_done_here =
        commands_.find(owed.command.key, [&](const TakenCommands::Entry& each) {
          return each.is_own() && each.is_copy(owed.command.key, owed.came);
        });
    const Fate fate = is_done_here ? Fate::forget : fate_of(owed);
    if (fate == Fate::end && !is_being_ended(owed, now)) overdue.push_back(owed);
    return fate == Fate::forget;
  });
  for (const auto& owed : overdue) {
    Waiting waiting;
    waiting.robot = owed.robot;
    waiting.type = owed.command.type;
    waiting.key = owed.command.key;
    waiting.came = owed.came;
    waiting.kept = owed.kept;
    waiting.dead_owner = owed.gateway;
    insert(std::move(waiting));
  }
  make_room();
}

/// This gateway asks the others, or another one has just said that it ends it.
bool CommandTurns::is_being_ended(const TakenCommands::Entry& owed, TimePoint now) const {
  return has_copy(owed.command.key, owed.came) ||
         commands_.find(owed.command.key, [&](const TakenCommands::Entry& other) {
           return other.is_refusal && other.gateway != owed.gateway &&
                  other.is_copy(owed.command.key, owed.came) && now - other.taken < ending_patience;
         });
}

}  // namespace slamgw::fleet
