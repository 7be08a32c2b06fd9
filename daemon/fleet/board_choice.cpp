// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/board_choice.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "daemon/fleet/peers.hpp"

namespace slamgw::fleet {
namespace {

using std::chrono::milliseconds;

/// Weight of a new measurement in the smoothed level.
constexpr double gain = 1.0 / 8;
/// What two gateways have heard of one message differs by less: it is as late as the broker is.
constexpr milliseconds same_message{100};

}  // namespace

void BoardChoice::on_heard(const std::string& robot, std::optional<SignalLevel> level,
                           TimePoint now) {
  if (robots_.size() >= max_robots && !robots_.contains(robot)) return;
  Here& here = robots_[robot];
  std::ranges::rotate(here.latest, here.latest.begin() + 1);
  here.latest.back() = now;
  if (level) {
    const double before = here.level_db.value_or(level->db);
    here.level_db = before + (level->db - before) * gain;
  }
  for (auto& [gateway, elsewhere] : here.elsewhere) elsewhere.miss(now);
}

void BoardChoice::on_hears(const std::string& gateway, const Hears& hears, TimePoint now) {
  if (boards_.size() >= Peers::max_peers && !boards_.contains(gateway)) return;
  boards_[gateway] = {hears.is_board_up, now};
  for (const Hears::Row& row : hears.rows) {
    const auto known = robots_.find(row.robot);
    if (known == robots_.end()) continue;
    Elsewhere& elsewhere = known->second.elsewhere[gateway];
    elsewhere.level_db = row.level_db;
    const TimePoint heard = now - milliseconds(row.age_ms);
    if (heard < elsewhere.heard + same_message) continue;
    elsewhere.heard = heard;
    elsewhere.missed = 0;
    for (const TimePoint when : known->second.latest)
      if (when > heard + same_message) elsewhere.miss(when);
  }
}

std::vector<std::string> BoardChoice::candidates(TimePoint now) const {
  std::vector<std::string> found;
  if (!is_board_up_) return found;
  for (const auto& [robot, here] : robots_)
    if (now - here.last() < recent) found.push_back(robot);
  return found;
}

bool BoardChoice::should_take(const std::string& robot, const std::string& owner, TimePoint now) {
  const auto known = robots_.find(robot);
  if (!is_board_up_ || known == robots_.end() || now - known->second.last() >= recent) return false;
  Here& here = known->second;
  if (std::exchange(here.compared_with, owner) != owner) here.better_since.reset();
  if (is_board_down(owner, now)) return true;
  const auto board = boards_.find(owner);
  // An owner that has not told of this robot yet is given as long as one that has missed it.
  const auto [elsewhere, is_new] = here.elsewhere.try_emplace(owner);
  if (is_new) elsewhere->second = {Hears::lowest_level_db, {}, 1, now};
  if (is_deaf(elsewhere->second, board == boards_.end() ? nullptr : &board->second, now))
    return true;
  if (!is_better(here, owner, now)) {
    here.better_since.reset();
    return false;
  }
  if (!here.better_since) here.better_since = now;
  return now - *here.better_since >= better_for;
}

bool BoardChoice::is_board_down(const std::string& gateway, TimePoint now) const {
  const auto board = boards_.find(gateway);
  return board != boards_.end() && !board->second.is_up && now - board->second.heard_from < recent;
}

/// Messages were missed only if the owner has spoken since it should have heard them.
bool BoardChoice::is_deaf(const Elsewhere& owner, const Board* board, TimePoint now) const {
  if (owner.missed < most_missed || now - owner.missed_since < deaf_after) return false;
  if (board && board->heard_from >= owner.missed_since + hears_interval) return true;
  const TimePoint last = board ? board->heard_from : TimePoint{};
  return now - std::max(last, owner.missed_since) >= silent_after;
}

bool BoardChoice::is_better(const Here& here, const std::string& owner, TimePoint now) const {
  if (!here.level_db) return false;
  return std::ranges::all_of(here.elsewhere, [&](const auto& each) {
    const auto& [gateway, elsewhere] = each;
    const bool is_fresh = elsewhere.heard != TimePoint{} && now - elsewhere.heard < recent;
    if (!is_fresh) return gateway != owner;
    return *here.level_db >= elsewhere.level_db + (gateway == owner ? clearly_better_db : 0);
  });
}

std::optional<Hears> BoardChoice::next_hears(TimePoint now) {
  std::erase_if(robots_,
                [&](const auto& each) { return now - each.second.last() >= forget_after; });
  if (robots_.empty() && !is_board_up_) return std::nullopt;
  if (hears_published_ && now - *hears_published_ < hears_interval) return std::nullopt;
  hears_published_ = now;
  Hears hears{is_board_up_, {}};
  for (const auto& [robot, here] : robots_) {
    const Duration age = now - here.last();
    if (age >= recent || !is_board_up_) continue;
    hears.rows.push_back(
        {robot, static_cast<int>(std::lround(here.level_db.value_or(Hears::lowest_level_db))),
         static_cast<std::uint64_t>(std::chrono::duration_cast<milliseconds>(age).count())});
  }
  return hears;
}

void BoardChoice::forget_others() {
  boards_.clear();
  for (auto& [robot, here] : robots_) {
    here.elsewhere.clear();
    here.better_since.reset();
  }
}

}  // namespace slamgw::fleet
