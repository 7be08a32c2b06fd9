// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/command_turns.hpp"

#include <algorithm>
#include <utility>

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {

std::uint64_t CommandTurns::key_of(const BrokerMessage& command) {
  return fnv1a(as_text(command.payload), fnv1a(command.topic + '\n'));
}

void CommandTurns::add(BrokerMessage message, std::string robot, std::string type, TimePoint now) {
  forget_old(now);
  const std::uint64_t key = key_of(message);
  const auto cancelled = std::ranges::find(cancelled_, key, &Cancelled::key);
  if (cancelled != cancelled_.end()) {
    cancelled_.erase(cancelled);
    return;
  }
  waiting_octets_ += message.payload.size();
  waiting_.push_back({std::move(message), std::move(robot), std::move(type), key, now});
  make_room();
}

void CommandTurns::make_room() {
  while (waiting_.size() > max_waiting || waiting_octets_ > max_waiting_octets) {
    ++dropped_;
    waiting_octets_ -= waiting_.front().message.payload.size();
    waiting_.pop_front();
  }
}

std::vector<Taken> CommandTurns::decide(const Choose& choose, TimePoint now) {
  std::vector<Taken> said;
  std::erase_if(waiting_, [&](Waiting& waiting) {
    if (waiting.taking != 0) return false;
    const Choice choice = choose(waiting);
    if (choice == Choice::take || choice == Choice::refuse) {
      waiting.taking = ++last_id_;
      waiting.is_refusal = choice == Choice::refuse;
      waiting.said = now;
      waiting.is_repeated = false;
      said.push_back({waiting.taking, waiting.key, waiting.robot, waiting.type});
    }
    if (choice != Choice::forget) return false;
    waiting_octets_ -= waiting.message.payload.size();
    return true;
  });
  return said;
}

/// Under the same id: others know it already if it was only the echo that was lost.
std::vector<Taken> CommandTurns::repeat(TimePoint now) {
  std::vector<Taken> said;
  for (Waiting& waiting : waiting_) {
    if (waiting.taking == 0 || now - waiting.said < repeat_interval) continue;
    waiting.said = now;
    waiting.is_repeated = true;
    if (now - waiting.came >= owner_patience) waiting.is_refusal = true;
    said.push_back({waiting.taking, waiting.key, waiting.robot, waiting.type});
  }
  return said;
}

/// True when there is an equal command here. One that we are taking ourselves goes only to the
/// gateway of lesser id, which sees it in the same way, unless ours was lost, which that one can't
/// have seen.
bool CommandTurns::cancel(std::uint64_t key, bool is_stronger) {
  auto equal = std::ranges::find_if(
      waiting_, [&](const Waiting& waiting) { return waiting.key == key && waiting.taking == 0; });
  if (equal == waiting_.end()) {
    equal = std::ranges::find(waiting_, key, &Waiting::key);
    if (equal == waiting_.end()) return false;
    if (!is_stronger && !equal->is_repeated) return true;
  }
  waiting_octets_ -= equal->message.payload.size();
  waiting_.erase(equal);
  return true;
}

void CommandTurns::on_taken(const std::string& gateway, Life life, const Taken& taken,
                            const std::string& own_gateway, TimePoint now) {
  forget_old(now);
  if (!heard_.emplace(gateway, life, taken.id).second) return;  // the broker's copy
  heard_order_.push_back({gateway, life, taken.id, now});
  owed_.push_back({gateway, life, taken.robot, taken.type, now});
  if (!cancel(taken.key, gateway < own_gateway)) cancelled_.push_back({taken.key, now});
}

std::optional<CommandTurns::Waiting> CommandTurns::on_own_taken(std::uint64_t id) {
  const auto own = std::ranges::find(waiting_, id, &Waiting::taking);
  if (own == waiting_.end()) return std::nullopt;
  Waiting taken = std::move(*own);
  waiting_octets_ -= taken.message.payload.size();
  waiting_.erase(own);
  return taken;
}

void CommandTurns::on_new_life() {
  for (Waiting& waiting : waiting_) waiting.taking = 0;
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
  const auto is_old = [&](TimePoint since) { return now - since > taken_kept_for; };
  while (!cancelled_.empty() &&
         (is_old(cancelled_.front().since) || cancelled_.size() > max_taken)) {
    cancelled_.pop_front();
  }
  while (!heard_order_.empty() &&
         (is_old(heard_order_.front().at) || heard_order_.size() > max_taken)) {
    const Heard& oldest = heard_order_.front();
    heard_.erase({oldest.gateway, oldest.life, oldest.id});
    heard_order_.pop_front();
  }
}

}  // namespace slamgw::fleet
