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
  return {
      waiting.taking,    waiting.key, waiting.robot, waiting.type, to_age_ms(now - waiting.came),
      waiting.is_refusal};
}

std::vector<Taken> CommandTurns::add(BrokerMessage message, std::string robot, std::string type,
                                     const Choose& choose, TimePoint now) {
  forget_old(now);
  const std::uint64_t key = key_of(message);
  if (is_cancelled(key)) return {};
  Waiting waiting;
  waiting_octets_ += message.payload.size();
  waiting.message = std::move(message);
  waiting.robot = std::move(robot);
  waiting.type = std::move(type);
  waiting.key = key;
  waiting.came = now;
  const auto added = waiting_.emplace(++last_number_, std::move(waiting)).first;
  by_key_[key].insert(added->first);
  std::vector<Taken> said;
  decide_one(added, choose, now, said);
  make_room();
  return said;
}

bool CommandTurns::is_cancelled(std::uint64_t key) {
  const auto cancelled = cancelled_.find(key);
  if (cancelled == cancelled_.end()) return false;
  cancelled->second.pop_front();
  if (cancelled->second.empty()) cancelled_.erase(cancelled);
  return true;
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
  std::vector<Taken> said;
  for (auto each = waiting_.begin(); each != waiting_.end();) decide_one(each++, choose, now, said);
  return said;
}

void CommandTurns::decide_one(std::map<Number, Waiting>::iterator each, const Choose& choose,
                              TimePoint now, std::vector<Taken>& said) {
  Waiting& waiting = each->second;
  if (waiting.taking != 0) return;
  const Choice choice = choose(waiting);
  if (choice == Choice::forget) remove(each);
  if (choice != Choice::take && choice != Choice::refuse) return;
  waiting.taking = ++last_id_;
  taking_[waiting.taking] = each->first;
  waiting.is_refusal = choice == Choice::refuse;
  waiting.taken = waiting.said = now;
  waiting.copies = 1;
  waiting.contested.reset();
  waiting.settles.reset();
  said.push_back(to_taken(waiting, now));
}

/// Under the same id: others know it already if it was only the echo that was lost. A refusal is
/// said more than once in any case: who would object may have missed it.
std::vector<Taken> CommandTurns::repeat(TimePoint now) {
  std::vector<Taken> said;
  for (const auto& [id, number] : std::map(taking_)) {
    const auto each = waiting_.find(number);
    Waiting& waiting = each->second;
    if (waiting.contested && !waiting.settles) {
      if (now - *waiting.contested >= contest_patience) remove(each);
      continue;
    }
    const bool is_enough =
        waiting.settles && (!waiting.is_refusal || waiting.copies >= refusal_copies);
    if (is_enough || now - waiting.said < repeat_interval) continue;
    waiting.said = now;
    ++waiting.copies;
    said.push_back(to_taken(waiting, now));
  }
  return said;
}

/// True when there is an equal command here. Of two gateways that take one, both see in the same
/// way who must yield: who only refuses it, who has lost the robot, or else the greater id.
bool CommandTurns::cancel(const std::string& gateway, const Taken& taken,
                          const std::string& own_gateway, const StillOwns& still_owns,
                          TimePoint now) {
  const auto equal = by_key_.find(taken.key);
  if (equal == by_key_.end()) return false;
  const auto is_idle = [&](Number number) { return waiting_.at(number).taking == 0; };
  const auto idle = std::ranges::find_if(equal->second, is_idle);
  const auto each = waiting_.find(idle != equal->second.end() ? *idle : *equal->second.begin());
  Waiting& mine = each->second;
  const bool is_refusal = taken.is_refusal;
  bool must_yield = mine.taking == 0 || (mine.is_refusal && !is_refusal);
  if (!must_yield && mine.is_refusal == is_refusal)
    must_yield = is_refusal ? gateway < own_gateway : !still_owns(mine);
  if (must_yield) {
    remove(each);
  } else if (!mine.settles && !mine.contested) {
    mine.contested = now;
  }
  return true;
}

std::optional<Taken> CommandTurns::on_taken(const std::string& gateway, Life life,
                                            const Taken& taken, const std::string& own_gateway,
                                            const StillOwns& still_owns, TimePoint now) {
  forget_old(now);
  if (auto mine = answer(taken, now)) return mine;
  if (!is_news(gateway, life, taken.id, now)) return std::nullopt;  // the broker's copy
  owe(gateway, life, taken, now);
  if (!cancel(gateway, taken, own_gateway, still_owns, now)) {
    cancelled_[taken.key].push_back(now);
    cancelled_order_.emplace_back(now, taken.key);
  }
  return std::nullopt;
}

bool CommandTurns::is_news(const std::string& gateway, Life life, std::uint64_t id, TimePoint now) {
  if (!heard_.emplace(gateway, life, id).second) return false;
  heard_order_.push_back({gateway, life, id, now});
  return true;
}

/// As a command that is carried out, so that the other one yields.
std::optional<Taken> CommandTurns::answer(const Taken& taken, TimePoint now) const {
  if (!taken.is_refusal) return std::nullopt;
  const auto* mine = done_.find(taken.key, came_before(now, taken.age_ms));
  if (!mine || !mine->is_own) return std::nullopt;
  const auto& [robot, command, came, is_own] = *mine;
  return Taken{command.id, command.key, robot, command.type, to_age_ms(now - came), false};
}

/// Kept under an id of this gateway, which may have to hand it on.
void CommandTurns::on_done(const std::string& gateway, Life life, const std::string& robot,
                           const DoneCommand& done, TimePoint now) {
  forget_old(now);
  if (!is_news(gateway, life, done.id, now)) return;
  const TimePoint came = came_before(now, done.age_ms);
  done_.add({robot, {++last_id_, done.key, done.type, 0}, came, false}, now);
  const auto equal = by_key_.find(done.key);
  if (equal == by_key_.end()) return;
  const auto is_it = [&](Number number) {
    const Waiting& waiting = waiting_.at(number);
    return waiting.taking == 0 && waiting.came - came < DoneCommands::heard_apart &&
           came - waiting.came < DoneCommands::heard_apart;
  };
  const auto found = std::ranges::find_if(equal->second, is_it);
  if (found != equal->second.end()) remove(waiting_.find(*found));
}

/// A gateway that takes a command again in a new life owes one outcome.
void CommandTurns::owe(const std::string& gateway, Life life, const Taken& taken, TimePoint now) {
  const auto before = std::ranges::find_if(owed_, [&](const Owed& owed) {
    return owed.gateway == gateway && owed.life != life && owed.key == taken.key &&
           now - owed.taken < kept_for;
  });
  if (before != owed_.end()) owed_.erase(before);
  owed_.push_back(
      {gateway, life, taken.key, taken.robot, taken.type, now, came_before(now, taken.age_ms)});
}

std::optional<CommandTurns::Waiting> CommandTurns::on_own_taken(std::uint64_t id,
                                                                const StillOwns& still_owns,
                                                                TimePoint now) {
  const auto number = taking_.find(id);
  if (number == taking_.end()) return std::nullopt;
  const auto each = waiting_.find(number->second);
  Waiting& waiting = each->second;
  if (!waiting.is_refusal && still_owns(waiting)) return finish(each, now);
  if (!waiting.settles) waiting.settles = now + refusal_settling;
  return std::nullopt;
}

std::vector<CommandTurns::Waiting> CommandTurns::take_refused(TimePoint now) {
  std::vector<Waiting> refused;
  for (const auto& [id, number] : std::map(taking_)) {
    const auto each = waiting_.find(number);
    const auto& settles = each->second.settles;
    if (settles && now >= *settles) refused.push_back(finish(each, now));
  }
  return refused;
}

CommandTurns::Waiting CommandTurns::finish(std::map<Number, Waiting>::iterator each,
                                           TimePoint now) {
  Waiting finished = remove(each);
  const DoneCommand done{finished.taking, finished.key, finished.type, 0};
  done_.add({finished.robot, done, finished.came, true}, now);
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

void CommandTurns::on_new_life() {
  taking_.clear();
  for (auto& [number, waiting] : waiting_) waiting.taking = 0;
}

void CommandTurns::on_outcome(const std::string& gateway, const std::string& robot,
                              const std::string& type, TimePoint now) {
  const auto is_told = [&](const Owed& owed) { return owed.robot == robot && owed.type == type; };
  auto told = std::ranges::find_if(
      owed_, [&](const Owed& owed) { return owed.gateway == gateway && is_told(owed); });
  if (told == owed_.end()) {
    told = std::ranges::find_if(owed_, [&](const Owed& owed) {
      return now - owed.taken >= outcome_patience && is_told(owed);
    });
  }
  if (told != owed_.end()) owed_.erase(told);
}

std::vector<CommandTurns::Owed> CommandTurns::take_overdue(
    const std::function<Fate(const Owed&)>& fate_of, TimePoint now) {
  while (owed_.size() > max_taken) owed_.pop_front();
  std::vector<Owed> overdue;
  for (auto owed = owed_.begin(); owed != owed_.end() && now - owed->taken >= outcome_patience;) {
    const Fate fate = fate_of(*owed);
    if (fate == Fate::tell) overdue.push_back(*owed);
    owed = fate == Fate::wait ? std::next(owed) : owed_.erase(owed);
  }
  return overdue;
}

void CommandTurns::forget_old(TimePoint now) {
  const auto is_over = [&](const auto& entries, TimePoint since, Duration kept) {
    return now - since > kept || entries.size() > max_taken;
  };
  while (!cancelled_order_.empty() &&
         is_over(cancelled_order_, cancelled_order_.front().first, cancelled_kept_for)) {
    const auto [since, key] = cancelled_order_.front();
    cancelled_order_.pop_front();
    const auto cancelled = cancelled_.find(key);
    if (cancelled != cancelled_.end() && cancelled->second.front() == since) is_cancelled(key);
  }
  while (!heard_order_.empty() && is_over(heard_order_, heard_order_.front().at, taken_kept_for)) {
    const Heard& oldest = heard_order_.front();
    heard_.erase({oldest.gateway, oldest.life, oldest.id});
    heard_order_.pop_front();
  }
}

}  // namespace slamgw::fleet
