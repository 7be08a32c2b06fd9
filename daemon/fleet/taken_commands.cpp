// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/taken_commands.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::fleet {

void TakenCommands::add(Entry entry, bool is_owed, TimePoint now) {
  while (!entries_.empty() &&
         (now - entries_.front().taken > kept_for || entries_.size() >= max_entries)) {
    drop_oldest();
  }
  const Number number = first_number_ + entries_.size();
  std::vector<Number>& equal = by_key_[entry.command.key];
  if (equal.size() == max_equal) equal.erase(equal.begin());
  equal.push_back(number);
  if (is_owed) owed_.insert(number);
  entry.taken = now;
  entries_.push_back(std::move(entry));
}

void TakenCommands::drop_oldest() {
  const auto equal = by_key_.find(entries_.front().command.key);
  if (equal->second.front() == first_number_) equal->second.erase(equal->second.begin());
  if (equal->second.empty()) by_key_.erase(equal);
  owed_.erase(first_number_);
  entries_.pop_front();
  ++first_number_;
}

const TakenCommands::Entry* TakenCommands::find(std::uint64_t key, const Matches& matches) const {
  const auto equal = by_key_.find(key);
  if (equal == by_key_.end()) return nullptr;
  for (const Number number : equal->second)
    if (matches(at(number))) return &at(number);
  return nullptr;
}

const TakenCommands::Entry* TakenCommands::find_owed(const Matches& matches) const {
  const auto owed = std::ranges::find_if(owed_, [&](Number number) { return matches(at(number)); });
  return owed == owed_.end() ? nullptr : &at(*owed);
}

const TakenCommands::Entry* TakenCommands::find_owed(const Matches& matches,
                                                     TimePoint began) const {
  const Entry* best = nullptr;
  for (const Number number : owed_) {
    const Entry& entry = at(number);
    if (matches(entry) && (!best || entry.apart_from(began) < best->apart_from(began)))
      best = &entry;
  }
  return best;
}

bool TakenCommands::take_missing_copy(std::uint64_t key, bool is_owner, TimePoint now) {
  const auto equal = by_key_.find(key);
  if (equal == by_key_.end()) return false;
  for (const Number number : equal->second) {
    Entry& entry = at(number);
    const bool is_expected = is_owner ? now - entry.came <= owner_expects_copy_for
                                      : now - entry.taken <= copy_expected_for;
    if (is_expected && std::exchange(entry.is_copy_missing, false)) return true;
  }
  return false;
}

/// The first one. It may have waited before it was taken.
TakenCommands::Entries::const_iterator TakenCommands::find_of(const std::string& gateway,
                                                              const std::string& robot,
                                                              const std::string& type,
                                                              TimePoint came,
                                                              const Matches& matches) const {
  const auto first = std::ranges::lower_bound(entries_, came - heard_apart, {}, &Entry::taken);
  return std::find_if(first, entries_.end(), [&](const Entry& entry) {
    return entry.gateway == gateway && entry.robot == robot && entry.command.type == type &&
           came_together(entry.came, came) && matches(entry);
  });
}

bool TakenCommands::has_ended(const std::string& robot, const std::string& type,
                              TimePoint came) const {
  const auto is_ended = [](const Entry& entry) { return entry.is_ended; };
  return find_of({}, robot, type, came, is_ended) != entries_.end();
}

const TakenCommands::Entry* TakenCommands::find_own(const std::string& robot,
                                                    const std::string& type, TimePoint came) const {
  const auto own = find_of({}, robot, type, came, [](const Entry&) { return true; });
  return own == entries_.end() ? nullptr : &*own;
}

void TakenCommands::turn_to_refusal(std::uint64_t key, const Matches& matches) {
  const auto equal = by_key_.find(key);
  if (equal == by_key_.end()) return;
  for (const Number number : equal->second)
    if (matches(at(number))) at(number).is_refusal = true;
}

bool TakenCommands::end_of(const std::string& gateway, const std::string& robot,
                           const std::string& type, TimePoint came) {
  const auto is_open = [](const Entry& entry) { return !entry.is_ended; };
  const auto found = find_of(gateway, robot, type, came, is_open);
  if (found == entries_.end()) return false;
  entries_[std::size_t(found - entries_.begin())].is_ended = true;
  return true;
}

std::vector<DoneCommand> TakenCommands::of(const std::string& robot, TimePoint now) const {
  std::vector<DoneCommand> done;
  for (auto each = entries_.rbegin(); each != entries_.rend(); ++each) {
    if (now - each->taken > handed_on_for || done.size() == max_taken_commands) break;
    if (each->robot != robot || now - each->came > handed_on_for) continue;
    done.push_back(each->command);
    done.back().age_ms = to_age_ms(now - each->came);
  }
  return done;
}

void TakenCommands::end(std::uint64_t key, TimePoint came) {
  std::erase_if(owed_, [&](Number number) {
    Entry& entry = at(number);
    const bool is_meant = entry.is_copy(key, came);
    entry.is_ended = entry.is_ended || is_meant;
    return is_meant;
  });
}

void TakenCommands::forget_owed(const Matches& matches) {
  std::erase_if(owed_, [&](Number number) { return matches(at(number)); });
}

}  // namespace slamgw::fleet
