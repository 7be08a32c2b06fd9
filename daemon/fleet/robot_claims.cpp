// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/robot_claims.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::fleet {
namespace {

using std::chrono::milliseconds;

/// A claim for a robot that nobody has is won after so long without a greater one.
constexpr milliseconds settling{300};
constexpr milliseconds claim_repeats{1000};
/// A living owner that neither answers nor objects is passed over then, but not while the beats
/// that it has sent before it could hear the claim may hold its lease.
constexpr milliseconds release_patience{5000};
/// A larger period than that of `max_peers` gateways is forged.
constexpr milliseconds longest_release_patience{30'000};
/// A robot that was heard so lately may be claimed once more when a greater claim turns up.
constexpr milliseconds fresh{3000};
/// Twice as many as the core keeps, which says what it forgets.
constexpr std::size_t max_heard = 40'000;
/// Owners before the present one that are remembered, of so many robots.
constexpr std::size_t max_predecessors = 4;
constexpr std::size_t max_with_predecessors = 40'000;

}  // namespace

void RobotClaims::on_heard(const std::string& robot, const Now& now) {
  if (heard_.size() < max_heard || heard_.contains(robot)) heard_[robot] = now.mono;
  if (!membership_.may_act(now.mono) || held_.contains(robot)) return;
  const auto claiming = claiming_.find(robot);
  if (claiming == claiming_.end()) return claim_unless_guarded(robot, now);
  claiming->second.is_forgotten = false;
}

void RobotClaims::on_forgotten(const std::string& robot) {
  heard_.erase(robot);
  const auto claiming = claiming_.find(robot);
  if (claiming != claiming_.end()) claiming->second.is_forgotten = true;
  if (held_.erase(robot) > 0) drop_own_claim(robot);
}

void RobotClaims::drop_own_claim(const std::string& robot) {
  const auto row = membership_.table.find(robot);
  if (!row || !membership_.is_mine(row->claim)) return;
  if (row->claim.epoch < spent_epoch) dropped_epoch_ = std::max(dropped_epoch_, row->claim.epoch);
  membership_.table.erase(robot);
}

bool RobotClaims::keep(const std::string& robot, const Claim& claim, const Now& now) {
  if (membership_.table.set(robot, claim, now.wall)) return true;
  ++not_kept_;
  if (const auto count = full_.on_event(now.mono))
    membership_.notice(
        Severity::warning,
        fmt::format("{} robots are known in this fleet, and there is no room for '{}': nobody "
                    "serves it, and commands for it are refused; does somebody invent names of "
                    "robots? ({} claims like it since the last line)",
                    membership_.table.size(), robot, *count),
        robot);
  return false;
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
  const auto row = membership_.table.find(robot);
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
  const auto row = membership_.table.find(robot);
  if (row && row->claim.gateway == sender && !claiming_.contains(robot)) claim(robot, now);
}

void RobotClaims::claim_unless_guarded(const std::string& robot, const Now& now) {
  const auto row = membership_.table.find(robot);
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

/// Nothing while a living gateway has the greatest of all. A claim of the dead need not be beaten,
/// because nobody counts it.
std::optional<std::uint64_t> RobotClaims::next_epoch(const Claim* known, std::uint64_t first,
                                                     TimePoint now) const {
  if (!known) return first;
  const bool is_living = membership_.is_living(*known, now);
  if (!is_living && known->epoch >= spent_epoch) return first;
  if (known->epoch >= max_epoch) return std::nullopt;
  return known->epoch + 1;
}

void RobotClaims::claim(const std::string& robot, const Now& now) {
  const auto row = membership_.table.find(robot);
  const auto epoch = next_epoch(row ? &row->claim : nullptr, 1, now.mono);
  if (!epoch) return;
  begin_claim(robot, std::max(*epoch, dropped_epoch_ + 1), now);
  const auto claiming = claiming_.find(robot);
  if (claiming != claiming_.end()) publish_claim(robot, claiming->second, now.mono);
}

/// No effect when the table is full.
void RobotClaims::begin_claim(const std::string& robot, std::uint64_t epoch, const Now& now) {
  const auto row = membership_.table.find(robot);
  if (!keep(robot, {epoch, membership_.me, membership_.lease.life()}, now)) return;
  Claiming& claiming = claiming_[robot] = {};
  claiming.since = claiming.said = now.mono;
  claiming.epoch = epoch;
  if (!row || row->claim.gateway == membership_.me) return;
  formers_[robot] = row->claim.gateway;
  if (membership_.is_living(row->claim, now.mono))
    claiming.awaited[row->claim.gateway] = row->claim.life;
}

void RobotClaims::publish_claim(const std::string& robot, Claiming& claiming, TimePoint now) {
  claiming.said = now;
  const std::string from =
      claiming.awaited.empty() ? std::string() : claiming.awaited.begin()->first;
  // A broker that holds back messages with QoS 1 for an owner may still bring it those without.
  const Qos qos = claiming.times_said++ % 2 == 0 ? Qos::at_least_once : Qos::at_most_once;
  membership_.publish(membership_.topics.all(),
                      ClaimRobot{robot, membership_.table.find(robot)->claim.epoch, from}, qos);
}

void RobotClaims::on_own_claim(const std::string& robot, std::uint64_t epoch, const Now& now) {
  const auto claiming = claiming_.find(robot);
  if (claiming == claiming_.end() || membership_.table.find(robot)->claim.epoch != epoch) return;
  if (!claiming->second.echoed) claiming->second.echoed = now.mono;
  if (is_won(claiming->second, now.mono)) own(robot, now);
}

Duration RobotClaims::patience_with(const std::string& gateway) const {
  const Peers::Peer* peer = membership_.peers.find(gateway);
  if (!peer) return release_patience;
  return std::clamp<Duration>(peer->period * death_periods, release_patience,
                              longest_release_patience);
}

void RobotClaims::erase_void(Gateways& awaited, TimePoint since, TimePoint now) const {
  std::erase_if(awaited, [&](const auto& each) {
    return now - since >= patience_with(each.first) ||
           !membership_.peers.is_alive(each.first, each.second, now);
  });
}

bool RobotClaims::is_won(Claiming& claiming, TimePoint now) const {
  if (!claiming.echoed || !membership_.lease.is_valid(now)) return false;
  erase_void(claiming.awaited, claiming.since, now);
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
      publish_claim(robot, claiming, now.mono);
    }
  }
  for (const std::string& robot : won) own(robot, now);
  std::vector<std::string> passed;
  for (auto& [robot, passing] : passing_) {
    erase_void(passing.awaited, passing.since, now.mono);
    if (passing.awaited.empty()) {
      if (passing.is_given_up) passed.push_back(robot);
    } else if (now.mono - passing.said >= claim_repeats) {
      passing.said = now.mono;  // it may have missed this claim, and hear the next one only
      membership_.publish_to_all(ClaimRobot{robot, passing.epoch, passing.awaited.begin()->first});
    }
  }
  for (const std::string& robot : passed) pass_on(robot, now.mono);
}

void RobotClaims::own(const std::string& robot, const Now& now) {
  auto claiming = claiming_.extract(robot);
  Claiming& won = claiming.mapped();
  if (won.is_forgotten) {
    withdraw_entry_of_former(robot, now.mono);
    return drop_own_claim(robot);
  }
  held_[robot] = now.mono;
  has_won_ = true;
  withdraw_entries_of_predecessors(robot, now.mono);
  auto former = formers_.extract(robot);
  if (!former.empty() || won.was_released) ++roams_in_;
  if (won.epoch >= spent_epoch) begin_again(robot, now);
  membership_.actions.push(TakeOverRobot{
      robot, former.empty() ? std::string() : std::move(former.mapped()), std::move(won.session)});
}

/// Others take the lower epoch from this gateway's table (on_table).
void RobotClaims::begin_again(const std::string& robot, const Now& now) {
  membership_.table.set(robot, {1, membership_.me, membership_.lease.life()}, now.wall);
  publish_table(membership_.topics.all());
}

// --- Others' claims ------------------------------------------------------------------------------

void RobotClaims::on_claim(const std::string& robot, const Claim& claim, const std::string& from,
                           const Now& now) {
  if (membership_.phase == Phase::joining) heard_.erase(robot);  // it has gone there since
  merge(robot, claim, from, now);
  if (from.empty()) name_owner(robot, claim, now.mono);
}

/// Who claims a robot as nobody's has missed its owner's claim, and its owner may miss this one.
/// Two members say whose it is: one of them may have missed either.
void RobotClaims::name_owner(const std::string& robot, const Claim& claim, TimePoint now) {
  const auto row = membership_.table.find(robot);
  if (!row || row->claim <= claim || !membership_.is_living(row->claim, now)) return;
  if (is_among_first(claim.gateway, now)) release(robot, row->claim, claim.gateway, {}, now);
}

void RobotClaims::merge(const std::string& robot, const Claim& claim, const std::string& from,
                        const Now& now) {
  const auto known = membership_.table.find(robot);
  const std::optional<Claim> row = known ? std::optional(known->claim) : std::nullopt;
  const bool is_void = row && !membership_.is_mine(*row) && !membership_.is_living(*row, now.mono);
  if (row && !is_void && claim <= *row) return on_lesser_claim(robot, claim, *row, from, now);
  const auto claiming = claiming_.find(robot);
  // Who asks this gateway to make way has heard the robot after it had this gateway's claim.
  const bool was_behind =
      claiming != claiming_.end() && row && claim.epoch > row->epoch && from != membership_.me;
  if (!keep(robot, claim, now)) return;
  if (row) note_predecessor(robot, *row, claim);
  if (is_void && claim.epoch <= row->epoch && claim.gateway != row->gateway)
    withdraw_unknown_entry(robot, row->gateway, claim.gateway, now.mono);
  if (held_.contains(robot) || claiming != claiming_.end()) {
    give_way(robot, claim, now.mono);
  } else if (from == membership_.me) {
    // The gateway that took the robot over from this one must give way as well.
    const bool has_passed_on =
        row && row->gateway != claim.gateway && membership_.is_living(*row, now.mono);
    if (has_passed_on) {
      release(robot, *row, claim.gateway, {}, now.mono);
    } else {  // the core may have forgotten it, and its mesh not
      membership_.actions.push(GiveUpRobot{robot, claim, true});
    }
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
    const auto passing = passing_.find(robot);
    const bool is_early = passing != passing_.end() && passing->second.to == row;
    if (from == membership_.me && !is_early) release(robot, row, claim.gateway, {}, now.mono);
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
  membership_.publish_to_all(ClaimRobot{robot, row.epoch, {}});
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
    const auto former = formers_.find(robot);
    const bool may_die =
        former != formers_.end() && membership_.peers.is_alive(former->second, now);
    passing_[robot] = {to,
                       mine.epoch,
                       now,
                       now,
                       std::move(mine.awaited),
                       std::move(mine.session),
                       false,
                       may_die ? former->second : std::string()};
    withdraw_entry_of_former(robot, now);
  }
  membership_.actions.push(GiveUpRobot{robot, to, true});  // it may have a session here already
}

/// The next gateway knows this one as the former, and not the one that died.
void RobotClaims::withdraw_entry_of_former(const std::string& robot, TimePoint now) {
  const auto former = formers_.extract(robot);
  if (!former.empty()) withdraw_entry(robot, former.mapped(), now);
}

void RobotClaims::note_predecessor(const std::string& robot, const Claim& before,
                                   const Claim& after) {
  if (before.gateway == after.gateway || before.gateway == membership_.me) return;
  if (predecessors_.size() >= max_with_predecessors && !predecessors_.contains(robot)) return;
  std::vector<std::string>& known = predecessors_[robot];
  if (std::ranges::find(known, before.gateway) != known.end()) return;
  if (known.size() == max_predecessors) known.erase(known.begin());
  known.push_back(before.gateway);
}

void RobotClaims::withdraw_entries_of_predecessors(const std::string& robot, TimePoint now) {
  const auto known = predecessors_.extract(robot);
  if (known.empty()) return;
  for (const std::string& gateway : known.mapped()) withdraw_entry(robot, gateway, now);
}

/// Of a gateway that lives it is not this one's to withdraw. No effect without a gateway.
void RobotClaims::withdraw_entry(const std::string& robot, const std::string& gateway,
                                 TimePoint now) {
  if (gateway.empty() || gateway == membership_.me || membership_.peers.is_alive(gateway, now))
    return;
  membership_.actions.push(PublishNow{{membership_.topics.presence(gateway, robot),
                                       {},
                                       Qos::at_least_once,
                                       /*retain=*/true}});
}

/// Who claims a robot with no greater epoch than the dead gateway had does not know that it had it,
/// and leaves its presence entry. Two members withdraw it: one of them may have missed the claim.
void RobotClaims::withdraw_unknown_entry(const std::string& robot, const std::string& dead,
                                         const std::string& claimant, TimePoint now) {
  if (is_among_first(claimant, now)) withdraw_entry(robot, dead, now);
}

/// Whether this member is one of the first two by name, but for the claimant.
bool RobotClaims::is_among_first(const std::string& claimant, TimePoint now) const {
  constexpr std::size_t enough = 2;
  if (!membership_.may_act(now)) return false;
  std::size_t before = membership_.peers.count_alive_before(membership_.me, now);
  if (claimant < membership_.me && membership_.peers.is_alive(claimant, now)) --before;
  return before < enough;
}

void RobotClaims::pass_on(const std::string& robot, TimePoint now) {
  auto passing = passing_.extract(robot);
  if (passing.empty()) return;
  withdraw_entry(robot, passing.mapped().former, now);
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
  if (passing.former == sender) passing.former.clear();
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
                      Release{robot, to, std::move(session), membership_.commands.of(robot, now),
                              to_clock_ms(now)});
}

void RobotClaims::on_release(const std::string& sender, const Release& release, const Now& now) {
  on_passed(sender, release, now.mono);
  const auto found = claiming_.find(release.robot);
  if (found == claiming_.end()) return;
  Claiming& claiming = found->second;
  const Claim mine = membership_.table.find(release.robot)->claim;
  const bool is_to_me = release.to.gateway == mine.gateway && release.to.life == mine.life;
  if (is_to_me && !release.session.empty()) claiming.session = release.session;
  // The sender has made way for an earlier claim, and may have claimed the robot again since.
  if (is_to_me && release.to < mine) return;
  if (release.to > mine) {
    if (membership_.is_living(release.to, now.mono))
      return merge(release.robot, release.to, {}, now);
  } else if (release.to != mine && membership_.is_living(release.to, now.mono) &&
             !claiming.released.contains(release.to.gateway)) {
    claiming.awaited[release.to.gateway] = release.to.life;  // made way for that one
  }
  claiming.released.insert(sender);
  claiming.awaited.erase(sender);
  const auto former = formers_.find(release.robot);
  if (former != formers_.end() && former->second == sender) formers_.erase(former);
  claiming.was_released = true;
  if (is_won(claiming, now.mono)) own(release.robot, now);
}

// --- Many at once --------------------------------------------------------------------------------

void RobotClaims::begin_life() {
  held_.clear();
  claiming_.clear();
  passing_.clear();
  dropped_epoch_ = 0;
  sweep_.clear();
}

void RobotClaims::forget_all() {
  begin_life();
  formers_.clear();
  predecessors_.clear();
  boards_.forget_others();
  heard_.clear();
  membership_.table.clear();
}

void RobotClaims::join(const std::vector<LocalRobot>& local, const Now& now) {
  ClaimTable& table = membership_.table;
  for (const auto& [robot, is_online] : local) {
    const auto row = table.find(robot);
    if (row && membership_.is_living(row->claim, now.mono)) {
      if (has_come_here(robot)) claim(robot, now);
      if (!claiming_.contains(robot)) {
        withdraw_entry_of_former(robot, now.mono);
        membership_.actions.push(GiveUpRobot{robot, row->claim, false});
      }
      continue;
    }
    const auto epoch = next_epoch(row ? &row->claim : nullptr, is_online ? 1 : 0, now.mono);
    begin_claim(robot, epoch.value_or(1), now);
  }
  const Life life = membership_.lease.life();
  for (Life past = membership_.lease.first_life(); past < life; ++past)
    table.erase_life(membership_.me, past);
  if (!claiming_.empty()) publish_table(membership_.topics.all());
}

/// Heard since this life began, and claimed by nobody else after that. Not in a mesh that boards of
/// other gateways hear, too.
bool RobotClaims::has_come_here(const std::string& robot) const {
  const auto heard = heard_.find(robot);
  return heard != heard_.end() && heard->second >= membership_.lease.life_began() &&
         !boards_.knows(robot);
}

void RobotClaims::publish_table(const std::string& topic) {
  Table table;
  for (auto& [robot, epoch] :
       membership_.table.claims_of(membership_.me, membership_.lease.life())) {
    if (table.rows.size() == max_table_rows) {
      table.upto = table.rows.back().robot;
      membership_.publish(topic, table);
      table = {table.upto, {}, {}};
    }
    table.rows.push_back({std::move(robot), epoch});
  }
  membership_.publish(topic, table);
}

void RobotClaims::on_table(const std::string& sender, Life life, const Table& table,
                           const Now& now) {
  if (sender == membership_.me) {
    for (const auto& [robot, epoch] : table.rows) on_own_claim(robot, epoch, now);
    return;
  }
  std::size_t theirs = 0;
  for (const auto& [robot, epoch] : table.rows) {
    drop_spent(robot, {epoch, sender, life});
    merge(robot, {epoch, sender, life}, {}, now);
    const auto row = membership_.table.find(robot);
    theirs += row && row->claim.gateway == sender && row->claim.life == life ? 1 : 0;
  }
  if (membership_.table.digest_of(sender, life).count > theirs)
    for (const std::string& robot : sweep_.unlisted(membership_.table, sender, life, table))
      membership_.table.erase(robot);
  if (table.upto.empty()) sweep_.on_last_message(sender);
}

/// The owner has begun again at a lower epoch.
void RobotClaims::drop_spent(const std::string& robot, const Claim& listed) {
  const auto row = membership_.table.find(robot);
  if (row && row->claim.gateway == listed.gateway && row->claim.life == listed.life &&
      row->claim.epoch >= spent_epoch && listed.epoch < spent_epoch)
    membership_.table.erase(robot);
}

void RobotClaims::forget_the_dead(TimePoint now) {
  sweep_.clear();  // of gateways that died before their last message
  std::vector<ClaimTable::Owner> dead = membership_.table.owners();
  std::erase_if(dead, [&](const auto& owner) {
    const Claim claim{0, owner.first, owner.second};
    return membership_.is_mine(claim) || membership_.is_living(claim, now);
  });
  for (const auto& owner : std::exchange(dead_, dead)) {
    const auto& [gateway, life] = owner;
    if (std::ranges::binary_search(dead, owner)) membership_.table.erase_life(gateway, life);
  }
  if (membership_.phase == Phase::member)
    std::erase_if(formers_, [&](const auto& each) { return !claiming_.contains(each.first); });
  predecessors_.clear();
  std::erase_if(objected_,
                [&](const auto& each) { return now - each.second > objection_interval; });
}

// --- Questions -----------------------------------------------------------------------------------

bool RobotClaims::speaks_for(const std::string& robot, TimePoint now) const {
  if (held_.contains(robot)) return true;
  const auto claiming = claiming_.find(robot);
  if (claiming != claiming_.end()) return claiming->second.awaited.empty();
  const auto row = membership_.table.find(robot);
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
