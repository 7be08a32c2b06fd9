// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/board_choice.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw::sessions {
namespace {

using nlohmann::json;
using std::chrono::milliseconds;

/// Weight of a new measurement in the smoothed level.
constexpr double gain = 1.0 / 8;
/// Two gateways' times of one message differ by less than this, which is the broker's delay.
constexpr milliseconds same_message{100};

bool is_between(const json& number, std::int64_t least, std::int64_t most) {
  if (!number.is_number_integer()) return false;
  if (number.is_number_unsigned() && number.get<std::uint64_t>() > INT64_MAX) return false;
  return number.get<std::int64_t>() >= least && number.get<std::int64_t>() <= most;
}

std::optional<Hears::Row> read_row(const json& row) {
  constexpr std::int64_t longest_age_ms = 3'600'000;
  const bool is_whole = row.is_array() && row.size() == 3 && row[0].is_string() &&
                        is_valid_level(row[0].get_ref<const std::string&>()) &&
                        is_between(row[1], Hears::lowest_level_db, Hears::highest_level_db) &&
                        is_between(row[2], 0, longest_age_ms);
  if (!is_whole) return std::nullopt;
  return Hears::Row{row[0], row[1], milliseconds(row[2].get<std::int64_t>())};
}

}  // namespace

std::string to_json_text(const Hears& hears) {
  json rows = json::array();
  for (const auto& [robot, level_db, age] : hears.rows)
    rows.push_back(json::array({robot, level_db, age.count()}));
  return json{{"up", hears.is_board_up}, {"rows", std::move(rows)}}.dump();
}

std::optional<Hears> read_hears(ByteView payload) {
  if (payload.size() > Hears::max_octets) return std::nullopt;
  const json read = json::parse(payload.begin(), payload.end(), nullptr, false);
  const bool is_whole = read.is_object() && read.contains("up") && read["up"].is_boolean() &&
                        read.contains("rows") && read["rows"].is_array() &&
                        read["rows"].size() <= Hears::max_rows;
  if (!is_whole) return std::nullopt;
  Hears hears{read["up"], {}};
  for (const json& each : read["rows"]) {
    auto row = read_row(each);
    if (!row) return std::nullopt;
    hears.rows.push_back(*std::move(row));
  }
  return hears;
}

void BoardChoice::on_heard(const std::string& robot, std::optional<SignalLevel> level,
                           TimePoint now) {
  if (robots_.size() >= max_robots && !robots_.contains(robot)) return;
  HeardHere& here = robots_[robot];
  std::rotate(here.latest.begin(), here.latest.begin() + 1, here.latest.end());
  here.latest.back() = now;
  if (level) {
    const double before = here.level_db.value_or(level->db);
    here.level_db = before + (level->db - before) * gain;
  }
  for (auto& [gateway, elsewhere] : here.elsewhere) elsewhere.miss(now);
}

void BoardChoice::on_hears(const std::string& gateway, const Hears& hears, TimePoint now) {
  if (boards_.size() >= max_boards && !boards_.contains(gateway)) return;
  boards_[gateway] = {hears.is_board_up, now};
  for (const Hears::Row& row : hears.rows) {
    const auto known = robots_.find(row.robot);
    if (known == robots_.end()) continue;
    HeardElsewhere& elsewhere = known->second.elsewhere[gateway];
    elsewhere.level_db = row.level_db;
    const TimePoint heard = now - row.age;
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

bool BoardChoice::should_take(const std::string& robot, const std::string& holder, TimePoint now) {
  const auto known = robots_.find(robot);
  if (!is_board_up_ || known == robots_.end() || now - known->second.last() >= recent) return false;
  HeardHere& here = known->second;
  if (std::exchange(here.compared_with, holder) != holder) here.better_since.reset();
  if (holder.empty() || is_board_down(holder, now)) return true;
  const auto board = boards_.find(holder);
  // A holder that has not reported this robot yet gets the same time as one that has missed it.
  const auto [elsewhere, is_new] = here.elsewhere.try_emplace(holder);
  if (is_new) elsewhere->second = {Hears::lowest_level_db, {}, 1, now};
  if (is_deaf(elsewhere->second, board == boards_.end() ? nullptr : &board->second, now))
    return true;
  if (!is_better(here, holder, now)) {
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

/// Returns true when the holder has missed the robot's messages. They count as missed only if the
/// holder has reported since it should have heard them, or is silent.
bool BoardChoice::is_deaf(const HeardElsewhere& holder, const Board* board, TimePoint now) const {
  if (holder.missed < most_missed || now - holder.missed_since < deaf_after) return false;
  if (board && board->heard_from >= holder.missed_since + hears_interval) return true;
  const TimePoint last = board ? board->heard_from : TimePoint{};
  return now - std::max(last, holder.missed_since) >= silent_after;
}

bool BoardChoice::is_better(const HeardHere& here, const std::string& holder, TimePoint now) const {
  if (!here.level_db) return false;
  return std::ranges::all_of(here.elsewhere, [&](const auto& each) {
    const auto& [gateway, elsewhere] = each;
    const bool is_fresh = elsewhere.heard != TimePoint{} && now - elsewhere.heard < recent;
    if (!is_fresh) return gateway != holder;
    return *here.level_db >= elsewhere.level_db + (gateway == holder ? clearly_better_db : 0);
  });
}

std::optional<Hears> BoardChoice::next_hears(TimePoint now) {
  forget_silent(now);
  if (robots_.empty() && !is_board_up_) return std::nullopt;
  if (hears_published_ && now - *hears_published_ < hears_interval) return std::nullopt;
  hears_published_ = now;
  Hears hears{is_board_up_, {}};
  for (const auto& [robot, here] : robots_) {
    const Duration age = now - here.last();
    if (age >= recent || !is_board_up_) continue;
    hears.rows.push_back(
        {robot, static_cast<int>(std::lround(here.level_db.value_or(Hears::lowest_level_db))),
         std::chrono::duration_cast<milliseconds>(age)});
  }
  return hears;
}

void BoardChoice::forget_silent(TimePoint now) {
  std::erase_if(robots_,
                [&](const auto& each) { return now - each.second.last() >= forget_after; });
  const auto is_silent = [&](const auto& board) {
    return now - board.second.heard_from >= forget_after;
  };
  if (std::erase_if(boards_, is_silent) == 0) return;
  for (auto& [robot, here] : robots_)
    std::erase_if(here.elsewhere, [&, &holder = here.compared_with](const auto& each) {
      return each.first != holder && !boards_.contains(each.first);
    });
}

}  // namespace slamgw::sessions
