// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/robot_claims.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>

namespace slamgw::fleet {
namespace {

using std::chrono::milliseconds;

/// A claim for a robot that nobody has is won after so long without a greater one.
constexpr milliseconds settling{300};
constexpr milliseconds claim_repeats{1000};
/// A living owner that neither answers nor objects is passed over then.
constexpr milliseconds release_patience{5000};
/// For the gateway before to make way; a session that comes later is lost.
constexpr milliseconds passing_patience{2000};
/// A robot that was heard so lately may be claimed once more when a greater claim turns up.
constexpr milliseconds fresh{3000};
constexpr std::size_t max_heard = 20'000;  // as RobotRegistry

}  // namespace

void RobotClaims::on_heard(const std::string& robot, const Now& now) {
  if (heard_.size() >= max_heard && !heard_.contains(robot)) return;
  heard_[robot] = now.mono;
  if (!membership_.may_act(now.mono)) return;
  if (held_.contains(robot) || claiming_.contains(robot)) return;
  claim_unless_guarded(robot, now);
}

void RobotClaims::on_heard_too(const std::string& robot, std::optional<SignalLevel> level,
                               const Now& now) {
  boards_.on_heard(robot, level, now.mono);
  if (membership_.phase == Phase::alone) return;
  if (boards_.knows(robot)) heard_[robot] = now.mono;
  claim_if_chosen(robot, now);
}

void RobotClaims::on_board(bool is_up, const Now& now) {
  if (boards_.on_board(is_up)) choose_boards(now);
}

void RobotClaims::on_hears(const std::string& sender, const Hears& hears, const Now& now) {
  boards_.on_hears(sender, hears, now.mono);
  for (const std::string& robot : boards_.candidates(now.mono)) claim_if_chosen(robot, now);
}

void RobotClaims::claim_if_chosen(const std::string& robot, const Now& now) {
  if (!membership_.may_act(now.mono) || held_.contains(robot) || claiming_.contains(robot)) return;
  const auto* row = membership_.table.find(robot);
  const bool has_owner = row && membership_.is_living(row->claim, now.mono);
  if (has_owner && !boards_.should_take(robot, row->claim.gateway, now.mono)) return;
  // Nobody answers the robot meanwhile, so the guard against two robots of one name must not wait.
  if (has_owner && boards_.is_board_down(row->claim.gateway, now.mono)) return claim(robot, now);
  claim_unless_guarded(robot, now);
}

/// Also of robots that say nothing just now: one that repeats its message ever more slowly must not
/// have to say it once more before somebody serves it.
void RobotClaims::choose_boards(const Now& now) {
  if (!membership_.may_act(now.mono)) return;
  if (const auto hears = boards_.next_hears(now.mono))
    membership_.publish(membership_.topics.all(), *hears, Qos::at_most_once);
  for (const std::string& robot : boards_.candidates(now.mono)) claim_if_chosen(robot, now);
}

void RobotClaims::on_question(const std::string& robot, const std::string& sender, const Now& now) {
  if (!membership_.may_act(now.mono)) return;
  const auto* row = membership_.table.find(robot);
  if (row && row->claim.gateway == sender && !claiming_.contains(robot)) claim(robot, now);
}

void RobotClaims::claim_unless_guarded(const std::string& robot, const Now& now) {
  const auto* row = membership_.table.find(robot);
  const bool has_owner = row && membership_.is_living(row->claim, now.mono);
  if (has_owner && !guard_.may_claim(robot, now.mono)) return;
  const unsigned in_a_row = has_owner ? guard_.on_claim(robot, now.mono) : 0;
  if (in_a_row > RoamGuard::free_claims) {
    if (const auto count = restless_.on_event(now.mono)) {
      membership_.notice(
          Severity::warning,
          fmt::format("robot '{}' moves between this gateway and '{}' again and again; are there "
                      "two robots with this name? ({} like it since the last line)",
                      robot, row->claim.gateway, *count),
          robot);
    }
  }
  claim(robot, now);
}

void RobotClaims::claim(const std::string& robot, const Now& now) {
  const auto* row = membership_.table.find(robot);
  if (row && row->claim.epoch >= max_epoch) return;
  Claiming claiming;
  claiming.since = now.mono;
  claiming.epoch = row ? row->claim.epoch + 1 : 1;
  if (row && row->claim.gateway != membership_.me) {
    claiming.former = row->claim.gateway;
    if (membership_.is_living(row->claim, now.mono))
      claiming.awaited[row->claim.gateway] = row->claim.life;
  }
  const Claim mine{claiming.epoch, membership_.me, membership_.lease.life()};
  if (!membership_.table.set(robot, mine, now.wall)) return;
  say_claim(robot, claiming_[robot] = std::move(claiming), now.mono);
}

void RobotClaims::say_claim(const std::string& robot, Claiming& claiming, TimePoint now) {
  claiming.said = now;
  const std::string from =
      claiming.awaited.empty() ? std::string() : claiming.awaited.begin()->first;
  membership_.tell_all(ClaimRobot{robot, membership_.table.find(robot)->claim.epoch, from});
}

void RobotClaims::on_own_claim(const std::string& robot, std::uint64_t epoch, const Now& now) {
  const auto claiming = claiming_.find(robot);
  if (claiming == claiming_.end() || membership_.table.find(robot)->claim.epoch != epoch) return;
  if (!claiming->second.echoed) claiming->second.echoed = now.mono;
  if (is_won(claiming->second, now.mono)) own(robot, now.mono);
}

bool RobotClaims::is_won(Claiming& claiming, TimePoint now) const {
  if (!claiming.echoed || !membership_.lease.is_valid(now)) return false;
  const bool is_late = now - claiming.since >= release_patience;
  std::erase_if(claiming.awaited, [&](const auto& each) {
    return is_late || !membership_.peers.is_alive(each.first, each.second, now);
  });
  if (!claiming.awaited.empty()) return false;
  return claiming.was_released || now - *claiming.echoed >= settling;
}

void RobotClaims::on_deadline(const Now& now) {
  choose_boards(now);
  std::vector<std::string> won;
  for (auto& [robot, claiming] : claiming_) {
    if (is_won(claiming, now.mono)) {
      won.push_back(robot);
    } else if (now.mono - claiming.said >= claim_repeats && membership_.lease.is_valid(now.mono)) {
      say_claim(robot, claiming, now.mono);
    }
  }
  for (const std::string& robot : won) own(robot, now.mono);
  std::vector<std::string> passed;
  for (auto& [robot, passing] : passing_) {
    std::erase_if(passing.awaited, [&](const auto& each) {
      return !membership_.peers.is_alive(each.first, each.second, now.mono);
    });
    const bool is_over = passing.awaited.empty() || now.mono >= passing.until;
    if (is_over && passing.is_given_up) passed.push_back(robot);
  }
  for (const std::string& robot : passed) pass_on(robot, now.mono);
}

void RobotClaims::own(const std::string& robot, TimePoint now) {
  auto claiming = claiming_.extract(robot);
  Claiming& won = claiming.mapped();
  held_[robot] = now;
  has_won_ = true;
  if (!won.former.empty()) ++roams_in_;
  const bool left_behind = !won.former.empty() && !won.released.contains(won.former);
  membership_.actions.push(
      TakeOverRobot{robot, left_behind ? won.former : std::string(), std::move(won.session)});
}

// --- Others' claims ------------------------------------------------------------------------------

void RobotClaims::merge(const std::string& robot, const Claim& claim, const std::string& from,
                        const Now& now) {
  const auto* known = membership_.table.find(robot);
  const std::optional<Claim> row = known ? std::optional(known->claim) : std::nullopt;
  const bool is_void = row && !membership_.is_mine(*row) && !membership_.is_living(*row, now.mono);
  if (row && !is_void && claim <= *row) return on_lesser_claim(robot, claim, *row, from, now);
  const auto claiming = claiming_.find(robot);
  // Who asks this gateway to make way has heard the robot after it had this gateway's claim.
  const bool was_behind =
      claiming != claiming_.end() && row && claim.epoch > row->epoch && from != membership_.me;
  if (!membership_.table.set(robot, claim, now.wall)) return;
  if (held_.contains(robot) || claiming != claiming_.end()) {
    give_way(robot, claim, now.mono);
  } else if (from == membership_.me) {
    // The gateway that took the robot over from this one must give way as well.
    const bool has_passed_on =
        row && row->gateway != claim.gateway && membership_.is_living(*row, now.mono);
    release(robot, has_passed_on ? *row : claim, claim.gateway, {}, now.mono);
  }
  const auto heard = heard_.find(robot);
  const bool is_heard_here_only = !boards_.knows(robot);
  if (was_behind && is_heard_here_only && heard != heard_.end() &&
      now.mono - heard->second < fresh && membership_.lease.is_valid(now.mono))
    claim_unless_guarded(robot, now);
}

void RobotClaims::on_lesser_claim(const std::string& robot, const Claim& claim, const Claim& row,
                                  const std::string& from, const Now& now) {
  if (!membership_.is_mine(row)) {
    if (from == membership_.me) release(robot, row, claim.gateway, {}, now.mono);
    return;
  }
  const auto claiming = claiming_.find(robot);
  if (claiming != claiming_.end()) {  // a rival, who will see the greater claim and make way
    if (!claiming->second.released.contains(claim.gateway))
      claiming->second.awaited[claim.gateway] = claim.life;
    return;
  }
  TimePoint& last = objected_[robot];
  if (now.mono - last < objection_interval) return;
  last = now.mono;
  membership_.tell_all(ClaimRobot{robot, row.epoch, {}});
}

/// A greater claim than ours has come.
void RobotClaims::give_way(const std::string& robot, const Claim& to, TimePoint now) {
  if (held_.erase(robot) > 0) {
    ++roams_out_;
    heard_.erase(robot);
    membership_.actions.push(GiveUpRobot{robot, to, true});
    membership_.notice(Severity::info,
                       fmt::format("robot '{}' is with gateway '{}' now", robot, to.gateway),
                       robot);
    return;
  }
  pass_on(robot, now);  // one that was passed on before must not wait for this one
  if (auto claiming = claiming_.extract(robot); !claiming.empty()) {
    Claiming& mine = claiming.mapped();
    // Claimed at the same time, it waits for this one. Claimed later, it has made way first.
    const bool is_rival = to.epoch <= mine.epoch;
    if (is_rival) mine.awaited.erase(to.gateway);
    passing_[robot] = {to, std::move(mine.awaited), std::move(mine.session), now + passing_patience,
                       false};
  }
  membership_.actions.push(GiveUpRobot{robot, to, true});  // it may have a session here already
}

void RobotClaims::pass_on(const std::string& robot, TimePoint now) {
  auto passing = passing_.extract(robot);
  if (passing.empty()) return;
  const Claim& to = passing.mapped().to;
  release(robot, to, to.gateway, std::move(passing.mapped().session), now);
}

void RobotClaims::on_passed(const std::string& sender, const Release& release, TimePoint now) {
  const auto found = passing_.find(release.robot);
  if (found == passing_.end()) return;
  Passing& passing = found->second;
  const Claim& made_way_for = release.to;
  if (!release.session.empty() && made_way_for.gateway == membership_.me && passing.session.empty())
    passing.session = release.session;
  if (made_way_for.gateway != membership_.me && made_way_for.gateway != passing.to.gateway &&
      membership_.is_living(made_way_for, now))
    passing.awaited[made_way_for.gateway] = made_way_for.life;
  passing.awaited.erase(sender);
  if (passing.is_given_up && passing.awaited.empty()) pass_on(release.robot, now);
}

void RobotClaims::on_given_up(const std::string& robot, const Claim& to, Bytes session,
                              TimePoint now) {
  constexpr std::size_t max_session_octets = max_payload_octets / 2 - 1024;  // it travels as hex
  if (session.size() > max_session_octets) {
    membership_.notice(
        Severity::warning,
        fmt::format("the session of '{}' has {} octets: too many to follow it to gateway '{}'",
                    robot, session.size(), to.gateway),
        robot);
    session.clear();
  }
  const auto passing = passing_.find(robot);
  if (passing == passing_.end() || passing->second.to != to)
    return release(robot, to, to.gateway, std::move(session), now);
  if (!session.empty()) passing->second.session = std::move(session);
  passing->second.is_given_up = true;
  if (passing->second.awaited.empty()) pass_on(robot, now);
}

void RobotClaims::release(const std::string& robot, const Claim& to, const std::string& receiver,
                          Bytes session, TimePoint now) {
  membership_.publish(membership_.topics.to(receiver),
                      Release{robot, to, std::move(session), membership_.done.of(robot, now)});
}

void RobotClaims::on_release(const std::string& sender, const Release& release, const Now& now) {
  on_passed(sender, release, now.mono);
  const auto found = claiming_.find(release.robot);
  if (found == claiming_.end()) return;
  Claiming& claiming = found->second;
  const Claim& mine = membership_.table.find(release.robot)->claim;
  if (release.to > mine) {
    if (membership_.is_living(release.to, now.mono))
      return merge(release.robot, release.to, {}, now);
  } else if (release.to != mine && membership_.is_living(release.to, now.mono) &&
             !claiming.released.contains(release.to.gateway)) {
    claiming.awaited[release.to.gateway] = release.to.life;  // made way for that one
  }
  claiming.released.insert(sender);
  claiming.awaited.erase(sender);
  claiming.was_released = true;
  if (!release.session.empty() && release.to == mine) claiming.session = release.session;
  if (is_won(claiming, now.mono)) own(release.robot, now.mono);
}

// --- Many at once --------------------------------------------------------------------------------

void RobotClaims::begin_life() {
  held_.clear();
  claiming_.clear();
  passing_.clear();
}

void RobotClaims::forget_all() {
  begin_life();
  boards_.forget_others();
  heard_.clear();
  membership_.table = {};
}

void RobotClaims::join(const std::vector<LocalRobot>& local, const Now& now) {
  ClaimTable& table = membership_.table;
  for (const auto& [robot, is_online] : local) {
    const auto* row = table.find(robot);
    if (row && membership_.is_living(row->claim, now.mono)) {
      membership_.actions.push(GiveUpRobot{robot, row->claim, false});
      continue;
    }
    if (row && row->claim.epoch >= max_epoch) continue;  // until it is forgotten
    const std::uint64_t first_epoch = is_online ? 1 : 0;
    const Claim mine{row ? row->claim.epoch + 1 : first_epoch, membership_.me,
                     membership_.lease.life()};
    Claiming claiming;
    if (row && row->claim.gateway != membership_.me) claiming.former = row->claim.gateway;
    claiming.since = claiming.said = now.mono;
    claiming.epoch = mine.epoch;
    if (table.set(robot, mine, now.wall)) claiming_[robot] = std::move(claiming);
  }
  const Life life = membership_.lease.life();
  for (Life past = membership_.lease.first_life(); past < life; ++past)
    table.erase_life(membership_.me, past);
  if (!claiming_.empty()) tell_table(membership_.topics.all());
}

void RobotClaims::tell_table(const std::string& topic) {
  Table table;
  for (const auto& [robot, row] : membership_.table.rows()) {
    if (!membership_.is_mine(row.claim)) continue;
    if (table.rows.size() == max_table_rows) {
      table.upto = table.rows.back().robot;
      membership_.publish(topic, table);
      table = {table.upto, {}, {}};
    }
    table.rows.push_back({robot, row.claim.epoch});
  }
  membership_.publish(topic, table);
}

void RobotClaims::on_table(const std::string& sender, Life life, const Table& table,
                           const Now& now) {
  if (sender == membership_.me) {
    for (const auto& [robot, epoch] : table.rows) on_own_claim(robot, epoch, now);
    return;
  }
  std::set<std::string_view> told;
  for (const auto& [robot, epoch] : table.rows) {
    told.insert(robot);
    merge(robot, {epoch, sender, life}, {}, now);
  }
  std::vector<std::string> dropped;
  const auto& rows = membership_.table.rows();
  for (auto row = rows.upper_bound(table.after); row != rows.end(); ++row) {
    const auto& [robot, entry] = *row;
    if (!table.upto.empty() && robot > table.upto) break;
    const bool is_theirs = entry.claim.gateway == sender && entry.claim.life == life;
    if (is_theirs && !told.contains(robot)) dropped.push_back(robot);
  }
  for (const std::string& robot : dropped) membership_.table.erase(robot);
}

void RobotClaims::forget_the_dead(TimePoint now) {
  std::vector<std::string> stale;
  for (const auto& [robot, row] : membership_.table.rows())
    if (!membership_.is_mine(row.claim) && !membership_.is_living(row.claim, now))
      stale.push_back(robot);
  for (const std::string& robot : std::exchange(stale_, stale))
    if (std::ranges::binary_search(stale, robot)) membership_.table.erase(robot);
  std::erase_if(objected_,
                [&](const auto& each) { return now - each.second > objection_interval; });
}

// --- Questions -----------------------------------------------------------------------------------

bool RobotClaims::speaks_for(const std::string& robot, TimePoint now) const {
  if (held_.contains(robot)) return true;
  const auto claiming = claiming_.find(robot);
  if (claiming != claiming_.end()) return claiming->second.awaited.empty();
  const auto* row = membership_.table.find(robot);
  return !row || !membership_.is_living(row->claim, now);
}

std::optional<TimePoint> RobotClaims::held_since(const std::string& robot) const {
  const auto held = held_.find(robot);
  return held == held_.end() ? std::nullopt : std::optional(held->second);
}

std::optional<TimePoint> RobotClaims::heard_at(const std::string& robot) const {
  const auto heard = heard_.find(robot);
  return heard == heard_.end() ? std::nullopt : std::optional(heard->second);
}

}  // namespace slamgw::fleet
