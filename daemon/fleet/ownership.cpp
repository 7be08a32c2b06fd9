// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/ownership.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/core/result.hpp"
#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

/// Contract: at most two beats a second. In a large fleet fewer, so that a gateway hears 200.
constexpr milliseconds shortest_period{500};
constexpr milliseconds period_per_gateway{5};
/// A claim for a robot that nobody has is won after so long without a greater one.
constexpr milliseconds settling{300};
constexpr milliseconds claim_repeats{1000};
/// A living owner that neither answers nor objects is passed over then.
constexpr milliseconds release_patience{5000};
constexpr milliseconds sign_patience{500};
constexpr milliseconds look_interval{50};
constexpr milliseconds listening{1000};
/// A broker may take half a second for each subscription.
constexpr std::chrono::seconds longest_look{10};
constexpr milliseconds longest_joining{3000};
constexpr std::chrono::seconds asleep_after{60};
constexpr std::size_t max_heard = 20'000;        // as RobotRegistry
constexpr std::size_t max_wills = 16;            // of one robot
constexpr std::size_t max_untold = 65'536;       // as CommandLedger
constexpr std::chrono::seconds told_within{30};  // before CommandTurns::outcome_patience
constexpr std::chrono::minutes forget_interval{5};

std::int64_t to_ms(TimePoint time) {
  return std::chrono::duration_cast<milliseconds>(time.time_since_epoch()).count();
}

}  // namespace

Ownership::Ownership(FleetTopics topics, Settings settings, LocalRobots local_robots)
    : topics_(std::move(topics)),
      settings_(settings),
      local_robots_(std::move(local_robots)),
      me_(topics_.gateway()),
      is_looking_(settings.enabled == Enabled::yes),
      life_(settings.process & ~Life{0xffff}) {}

void Ownership::on_broker_link(bool is_up, const Now& now) {
  is_link_up_ = is_up;
  is_muted_ = false;
  was_ever_echoed_ = false;
  // Nothing waits for the broker.
  if (!is_up && phase_ == Phase::alone && looked_) end_look(now.mono);
  if (!is_up || settings_.enabled == Enabled::no) return;
  subscribe(topics_.state_filter());
  if (phase_ == Phase::alone && settings_.enabled == Enabled::automatic) {
    is_looking_ = true;
    is_state_answered_ = false;
    looked_ = now.mono + longest_look;
    return;
  }
  wake_up(now);
}

void Ownership::on_subscribe_result(const std::string& filter, SubscribeAnswer answer,
                                    const Now& now) {
  // The next connection asks again, unless asking is what closes it.
  if (answer == SubscribeAnswer::refused) subscribed_.erase(filter);
  if (!looked_ || filter != topics_.state_filter()) return;
  if (answer != SubscribeAnswer::granted) return end_look(now.mono);
  if (!std::exchange(is_state_answered_, true)) looked_ = std::min(*looked_, now.mono + listening);
}

/// A broker that kept this gateway's session has sent commands that others have taken meanwhile,
/// and what they said: both are known by now.
void Ownership::end_look(TimePoint now) {
  is_looking_ = false;
  looked_.reset();
  decide_alone(now);
}

/// Nobody else is about: what waited for the others waits no longer.
void Ownership::decide_alone(TimePoint now) {
  for (auto& waiting : turns_.take_all()) {
    const Duration age = now - waiting.came;
    if (waiting.is_refusal || age >= CommandTurns::kept_for) {
      actions_.push(EndCommand{waiting.robot, waiting.type, CommandResult::refused,
                               "the gateways did not agree in time on who carries it out", age});
    } else {
      actions_.push(CarryOut{std::move(waiting.message)});
    }
  }
  for (auto& [robot, question] : std::exchange(questions_, {}))
    for (Report& will : question.wills) actions_.push(PublishWill{std::move(will)});
}

void Ownership::wake_up(const Now& now) {
  is_looking_ = false;
  looked_.reset();
  // The commands first: who hears the others and not the commands would miss what they leave to it.
  for (const std::string& filter : {topics_.command_filter(), topics_.all_filter(),
                                    topics_.own_filter(), topics_.outcome_filter()}) {
    subscribe(filter);
  }
  last_company_ = woken_ = now.mono;
  next_beat_ = now.mono;
  if (phase_ == Phase::alone || now.mono >= dead_at_) begin_life(now.mono);
}

/// The core asks for it again at each connection.
void Ownership::subscribe(const std::string& filter) {
  if (subscribed_.insert(filter).second) actions_.push(SubscribeFleet{filter});
}

void Ownership::begin_life(TimePoint now) {
  ++life_;
  phase_ = Phase::joining;
  joined_ = life_began_ = now;
  has_echo_ = false;
  leased_until_ = {};
  dead_at_ = TimePoint::max();
  held_.clear();
  claiming_.clear();
  turns_.on_new_life();
  for (auto& [robot, question] : questions_) question.asked.reset();
}

void Ownership::fall_asleep(std::string why, TimePoint now) {
  phase_ = Phase::alone;
  for (const std::string& filter : {topics_.all_filter(), topics_.own_filter(),
                                    topics_.command_filter(), topics_.outcome_filter()}) {
    if (subscribed_.erase(filter) > 0) actions_.push(UnsubscribeFleet{filter});
  }
  for (const auto& [robot, is_online] : local_robots_())
    if (!held_.contains(robot)) actions_.push(TakeOverRobot{robot, {}, {}});
  held_.clear();
  claiming_.clear();
  heard_.clear();
  table_ = {};
  peers_ = {};
  decide_alone(now);
  turns_.forget_owed();
  tell_outcomes(now);
  notice(Severity::notice, std::move(why));
}

void Ownership::on_other_gateway(const std::string& gateway, const Now& now) {
  last_company_ = now.mono;
  if (phase_ != Phase::alone || settings_.enabled != Enabled::automatic || !is_link_up_ ||
      is_muted_)
    return;
  notice(Severity::notice,
         fmt::format("gateway '{}' is on this broker too: from now on they agree who serves which "
                     "robot (fleet.enabled)",
                     gateway));
  wake_up(now);
}

// ------------------------------------------------------------------------------------------

bool Ownership::is_busy() const {
  return phase_ == Phase::joining || !claiming_.empty() || !questions_.empty() ||
         !turns_.is_empty() || !untold_.empty();
}

std::optional<TimePoint> Ownership::deadline() const {
  if (!is_link_up_) return std::nullopt;
  if (phase_ == Phase::alone) return looked_;
  return is_busy() ? std::min(next_beat_, last_look_ + look_interval) : next_beat_;
}

void Ownership::on_deadline(const Now& now) {
  if (!is_link_up_) return;
  if (phase_ == Phase::alone) {
    if (looked_ && now.mono >= *looked_) end_look(now.mono);
    return;
  }
  last_look_ = now.mono;
  if (now.mono >= dead_at_) begin_life(now.mono);
  if (now.mono >= next_beat_) {
    send_beat(now.mono);
    end_overdue_commands(now.mono);
    forget_the_dead(now.mono);
    if (peers_.count_alive(now.mono) > 0 || !states_.empty()) last_company_ = now.mono;
    if (settings_.enabled == Enabled::automatic && now.mono - last_company_ >= asleep_after)
      return fall_asleep("no other gateway is about any more; this one serves every robot",
                         now.mono);
    // With `true` it goes on trying and serves nobody: the operator has asked for one owner.
    if (settings_.enabled == Enabled::automatic && is_unheard(now.mono)) {
      is_muted_ = true;
      return fall_asleep(
          fmt::format("the broker gives back nothing of what this gateway writes under fleet/. "
                      "Its access control list needs, for this gateway's user: {} "
                      "(docs/fleet.md). Until the next connection this gateway serves every robot "
                      "that it hears, as if it were alone",
                      topics_.rights()),
          now.mono);
    }
  }
  if (phase_ == Phase::joining) finish_joining(now);
  look_at_claims(now);
  decide_commands(now);
  look_at_questions(now);
  tell_outcomes(now.mono);
}

std::vector<MissingRight> Ownership::missing_rights(TimePoint now) const {
  const bool tries = is_link_up_ && phase_ != Phase::alone;
  if (!is_muted_ && !(tries && is_unheard(now))) return {};
  return {{"other gateways do not hear this one: its own messages under fleet/ do not come back",
           topics_.rights()}};
}

Duration Ownership::period() const {
  const auto gateways = static_cast<int>(peers_.all().size()) + 1;
  return std::max<Duration>(shortest_period, period_per_gateway * gateways);
}

void Ownership::send_beat(TimePoint now) {
  const Duration wait = period();
  const auto digest = table_.digest_of(me_, life_);
  const auto period_ms = std::chrono::duration_cast<milliseconds>(wait).count();
  publish(topics_.all(),
          Beat{to_ms(now), static_cast<std::uint32_t>(period_ms), digest.count, digest.hash},
          Qos::at_most_once);
  next_beat_ = now + wait;
}

void Ownership::on_own_beat(const Beat& beat, TimePoint now) {
  if (beat.sent_ms < 0 || beat.sent_ms > to_ms(now)) return;  // a forgery
  const milliseconds age(to_ms(now) - beat.sent_ms);
  const TimePoint sent = now - age;
  const milliseconds wait(beat.period_ms);
  leased_until_ =
      std::max(leased_until_, sent + std::chrono::duration_cast<Duration>(wait * lease_periods));
  const TimePoint dead_at = sent + wait * death_periods;
  dead_at_ = has_echo_ ? std::max(dead_at_, dead_at) : dead_at;
  was_ever_echoed_ = true;
  if (!std::exchange(has_echo_, true)) joined_ = now;
}

bool Ownership::is_in_step(TimePoint now) const {
  return std::ranges::all_of(peers_.all(), [&](const auto& each) {
    const auto& [gateway, peer] = each;
    return now >= peer.alive_until || table_.digest_of(gateway, peer.life) == peer.digest;
  });
}

/// Claims at once what is here and nobody else has; gives up what others have taken over.
void Ownership::finish_joining(const Now& now) {
  const Duration since = now.mono - joined_;
  if (!is_leased(now.mono) || since < std::max<Duration>(listening, period() * 2)) return;
  if (!is_in_step(now.mono) && since < longest_joining + period() * 2) return;
  phase_ = Phase::member;
  for (const auto& [robot, is_online] : local_robots_()) {
    const auto* row = table_.find(robot);
    if (row && is_living(row->claim, now.mono)) {
      actions_.push(GiveUpRobot{robot, row->claim, false});
      continue;
    }
    const std::uint64_t first_epoch = is_online ? 1 : 0;
    const Claim mine{row ? row->claim.epoch + 1 : first_epoch, me_, life_};
    Claiming claiming;
    if (row && row->claim.gateway != me_) claiming.former = row->claim.gateway;
    claiming.since = claiming.said = now.mono;
    claiming.is_bulk = true;
    if (table_.set(robot, mine, now.wall)) claiming_[robot] = std::move(claiming);
  }
  for (Life past = life_ & ~Life{0xffff}; past < life_; ++past) table_.erase_life(me_, past);
  if (!claiming_.empty()) tell_table(topics_.all());
}

void Ownership::forget_the_dead(TimePoint now) {
  if (now - forgotten_at_ < forget_interval) return;
  forgotten_at_ = now;
  peers_.forget_dead(now);
  std::vector<std::string> stale;
  for (const auto& [robot, row] : table_.rows())
    if (!is_mine(row.claim) && !is_living(row.claim, now)) stale.push_back(robot);
  for (const std::string& robot : std::exchange(stale_, stale))
    if (std::ranges::binary_search(stale, robot)) table_.erase(robot);
  std::erase_if(objected_,
                [&](const auto& each) { return now - each.second > objection_interval; });
}

// --------------------------------------------------------------------------------------

// ----------------------------------------------------------------------------------------

bool Ownership::is_living(const Claim& claim, TimePoint now) const {
  return claim.gateway != me_ && peers_.is_alive(claim.gateway, claim.life, now);
}

void Ownership::on_heard(const std::string& robot, const Now& now) {
  if (phase_ == Phase::alone) return;
  questions_.erase(robot);
  if (heard_.size() >= max_heard && !heard_.contains(robot)) return;
  heard_[robot] = now.mono;
  if (phase_ != Phase::member || !is_leased(now.mono)) return;
  if (held_.contains(robot) || claiming_.contains(robot)) return;
  claim_unless_guarded(robot, now);
}

void Ownership::claim_unless_guarded(const std::string& robot, const Now& now) {
  const auto* row = table_.find(robot);
  const bool has_owner = row && is_living(row->claim, now.mono);
  if (has_owner && !guard_.may_claim(robot, now.mono)) return;
  const unsigned in_a_row = has_owner ? guard_.on_claim(robot, now.mono) : 0;
  if (in_a_row > RoamGuard::free_claims) {
    if (const auto count = restless_.on_event(now.mono)) {
      notice(
          Severity::warning,
          fmt::format("robot '{}' moves between this gateway and '{}' again and again; are there "
                      "two robots with this name? ({} like it since the last line)",
                      robot, row->claim.gateway, *count),
          robot);
    }
  }
  claim(robot, now);
}

void Ownership::claim(const std::string& robot, const Now& now) {
  const auto* row = table_.find(robot);
  if (row && row->claim.epoch >= max_epoch) return;
  Claiming claiming;
  claiming.since = now.mono;
  if (row && row->claim.gateway != me_) {
    claiming.former = row->claim.gateway;
    if (is_living(row->claim, now.mono)) claiming.awaited[row->claim.gateway] = row->claim.life;
  }
  if (!table_.set(robot, {row ? row->claim.epoch + 1 : 1, me_, life_}, now.wall)) return;
  say_claim(robot, claiming_[robot] = std::move(claiming), now.mono);
}

void Ownership::say_claim(const std::string& robot, Claiming& claiming, TimePoint now) {
  claiming.said = now;
  const std::string from =
      claiming.awaited.empty() ? std::string() : claiming.awaited.begin()->first;
  tell_all(ClaimRobot{robot, table_.find(robot)->claim.epoch, from});
}

void Ownership::on_own_claim(const std::string& robot, std::uint64_t epoch, const Now& now) {
  const auto claiming = claiming_.find(robot);
  if (claiming == claiming_.end() || table_.find(robot)->claim.epoch != epoch) return;
  if (!claiming->second.echoed) claiming->second.echoed = now.mono;
  if (is_won(claiming->second, now.mono)) own(robot, now);
}

/// A greater claim than ours has come.
void Ownership::give_way(const std::string& robot, const Claim& to) {
  questions_.erase(robot);
  if (held_.erase(robot) > 0) {
    ++roams_out_;
    heard_.erase(robot);
    actions_.push(GiveUpRobot{robot, to, true});
    notice(Severity::info, fmt::format("robot '{}' is with gateway '{}' now", robot, to.gateway),
           robot);
    return;
  }
  claiming_.erase(robot);
  actions_.push(GiveUpRobot{robot, to, true});  // it may have a session here already
}

void Ownership::on_given_up(const std::string& robot, const Claim& to, Bytes session) {
  constexpr std::size_t max_session_octets = max_payload_octets / 2 - 1024;  // it travels as hex
  if (session.size() > max_session_octets) {
    notice(Severity::warning,
           fmt::format("the session of '{}' has {} octets: too many to follow it to gateway '{}'",
                       robot, session.size(), to.gateway),
           robot);
    session.clear();
  }
  release(robot, to, to.gateway, std::move(session));
}

void Ownership::release(const std::string& robot, const Claim& to, const std::string& receiver,
                        Bytes session) {
  publish(topics_.to(receiver), Release{robot, to, std::move(session)}, Qos::at_least_once);
}

bool Ownership::is_won(Claiming& claiming, TimePoint now) const {
  if (!claiming.echoed || !is_leased(now)) return false;
  const bool is_late = now - claiming.since >= release_patience;
  std::erase_if(claiming.awaited, [&](const auto& each) {
    return is_late || !peers_.is_alive(each.first, each.second, now);
  });
  if (!claiming.awaited.empty()) return false;
  return claiming.was_released || now - *claiming.echoed >= settling;
}

void Ownership::look_at_claims(const Now& now) {
  std::vector<std::string> won;
  for (auto& [robot, claiming] : claiming_) {
    if (is_won(claiming, now.mono)) {
      won.push_back(robot);
    } else if (now.mono - claiming.said >= claim_repeats && is_leased(now.mono)) {
      say_claim(robot, claiming, now.mono);
    }
  }
  for (const std::string& robot : won) own(robot, now);
}

void Ownership::own(const std::string& robot, const Now& now) {
  auto claiming = claiming_.extract(robot);
  Claiming& won = claiming.mapped();
  held_.insert(robot);
  if (!won.former.empty()) ++roams_in_;
  const bool left_behind = !won.former.empty() && !won.released.contains(won.former);
  actions_.push(
      TakeOverRobot{robot, left_behind ? won.former : std::string(), std::move(won.session)});
  decide_commands(now);
}

// ----------------------------------------------------------------------------

void Ownership::on_command(BrokerMessage message, std::string robot, std::string type,
                           const Now& now) {
  if (!is_shared() || (message.retain && speaks_for(robot, now.mono))) {
    actions_.push(CarryOut{std::move(message)});
    return;
  }
  const bool is_probe =
      type == "probe" && (robot == me_ || states_.contains(robot) || peers_.find(robot));
  if (message.retain || is_probe) return;  // a gateway that tries its rights
  turns_.add(std::move(message), std::move(robot), std::move(type), now.mono);
  decide_commands(now);
}

void Ownership::decide_commands(const Now& now) {
  if (turns_.is_empty()) return;
  const auto said = turns_.decide(
      [&](const CommandTurns::Waiting& waiting) { return choose(waiting, now.mono); }, now.mono);
  for (const Taken& taken : said) tell_all(taken);
  if (!is_leased(now.mono)) return;
  for (const Taken& taken : turns_.repeat(now.mono)) tell_all(taken);
}

CommandTurns::Choice Ownership::choose(const CommandTurns::Waiting& waiting, TimePoint now) const {
  using Choice = CommandTurns::Choice;
  const Duration age = now - waiting.came;
  const bool is_over = age >= CommandTurns::kept_for;
  if (phase_ != Phase::member || !is_leased(now)) return is_over ? Choice::forget : Choice::wait;
  if (held_.contains(waiting.robot))
    return age < CommandTurns::owner_patience ? Choice::take : Choice::refuse;
  const auto* row = table_.find(waiting.robot);
  const bool has_owner = row && (is_mine(row->claim) || is_living(row->claim, now));
  const Duration patience = has_owner ? CommandTurns::last_patience : CommandTurns::owner_patience;
  if (age >= patience && rank_for(waiting.robot, now) == 0) return Choice::refuse;
  return is_over ? Choice::forget : Choice::wait;
}

/// Somebody has to speak for a robot that nobody serves: the living gateway of the greatest hash.
/// How many go before this one.
int Ownership::rank_for(const std::string& robot, TimePoint now) const {
  const std::uint64_t seed = fnv1a(robot + '\n');
  const std::uint64_t mine = fnv1a(me_, seed);
  return static_cast<int>(std::ranges::count_if(peers_.all(), [&](const auto& peer) {
    return now < peer.second.alive_until && fnv1a(peer.first, seed) > mine;
  }));
}

void Ownership::on_own_taken(const Taken& taken, const Now& now) {
  auto own = turns_.on_own_taken(taken.id);
  if (!own) return;
  const auto end = [&](const char* why) {
    actions_.push(
        EndCommand{own->robot, own->type, CommandResult::refused, why, now.mono - own->came});
  };
  if (own->is_refusal) return end("no gateway serves this robot");
  if (!may_act_for(own->robot, now.mono))
    return end("the robot moved to another gateway just then");
  actions_.push(CarryOut{std::move(own->message)});
}

void Ownership::on_outcome(const std::string& gateway, const std::string& robot,
                           const std::string& type, const Now& now) {
  if (gateway != me_) turns_.on_outcome(gateway, robot, type, now.mono);
}

/// The first may have started too late to know of it: then the next tells the outcome.
void Ownership::end_overdue_commands(TimePoint now) {
  using Fate = CommandTurns::Fate;
  constexpr std::chrono::seconds turn{2};
  constexpr int max_turns = 8;
  const auto fate_of = [&](const CommandTurns::Owed& owed) {
    if (peers_.is_alive(owed.gateway, owed.life, now)) return Fate::forget;
    if (!is_leased(now)) return Fate::wait;
    const int rank = rank_for(owed.robot, now);
    if (rank > max_turns) return Fate::forget;
    return now - owed.taken >= CommandTurns::outcome_patience + turn * rank ? Fate::tell
                                                                            : Fate::wait;
  };
  for (const auto& owed : turns_.take_overdue(fate_of, now)) {
    actions_.push(EndCommand{owed.robot,
                             owed.type,
                             CommandResult::timeout,
                             fmt::format("gateway '{}' took it and died", owed.gateway),
                             {}});
  }
}

void Ownership::on_will(Report will, const Now& now) {
  if (!is_shared()) {
    actions_.push(PublishWill{std::move(will)});
    return;
  }
  Question& question = questions_[will.robot];
  if (question.wills.size() < max_wills) question.wills.push_back(std::move(will));
  look_at_questions(now);
}

void Ownership::look_at_questions(const Now& now) {
  if (phase_ != Phase::member || !is_leased(now.mono)) return;
  for (auto each = questions_.begin(); each != questions_.end();) {
    const bool is_over = !speaks_for(each->first, now.mono) || is_answered(each->second, now);
    if (!is_over && !each->second.asked) ask_for_sign(each->first, each->second, now.mono);
    each = is_over ? questions_.erase(each) : std::next(each);
  }
}

void Ownership::ask_for_sign(const std::string& robot, Question& question, TimePoint now) {
  question.asked = now;
  question.is_echoed = false;
  const auto heard = heard_.find(robot);
  const Duration silent = heard == heard_.end() ? Duration(1h) : now - heard->second;
  tell_all(AskForSign{
      robot, static_cast<std::uint64_t>(std::chrono::duration_cast<milliseconds>(silent).count())});
}

/// A will is published when nobody has heard the robot since, and this gateway could have learned
/// of it.
bool Ownership::is_answered(Question& question, const Now& now) {
  const bool is_silent =
      question.asked && question.is_echoed && now.mono - *question.asked >= sign_patience;
  if (!is_silent) return false;
  for (Report& will : question.wills) actions_.push(PublishWill{std::move(will)});
  return true;
}

void Ownership::on_own_outcome(BrokerMessage outcome, Duration after, const Now& now) {
  if (untold_.size() >= max_untold) untold_.pop_front();
  untold_.push_back({std::move(outcome), now.mono - after});
  tell_outcomes(now.mono);
}

/// From a former life only as long as nobody else has told it.
void Ownership::tell_outcomes(TimePoint now) {
  if (phase_ != Phase::alone && !is_leased(now)) return;
  for (Untold& untold : std::exchange(untold_, {})) {
    const bool is_too_late = untold.came < life_began_ && now - untold.came >= told_within;
    if (phase_ == Phase::alone || !is_too_late)
      actions_.push(TellOutcome{std::move(untold.outcome)});
  }
}

// ------------------------------------------------------------------------

bool Ownership::speaks_for(const std::string& robot, TimePoint now) const {
  if (phase_ == Phase::alone || held_.contains(robot)) return true;
  const auto claiming = claiming_.find(robot);
  if (claiming != claiming_.end()) return claiming->second.awaited.empty();
  const auto* row = table_.find(robot);
  return !row || !is_living(row->claim, now);
}

bool Ownership::may_act_for(const std::string& robot, TimePoint now) const {
  if (phase_ == Phase::alone) return true;
  return phase_ == Phase::member && held_.contains(robot) && is_leased(now);
}

std::optional<Ownership::Place> Ownership::place_of(const std::string& robot, TimePoint now) const {
  const auto* row = table_.find(robot);
  if (!row) return std::nullopt;
  return Place{row->claim.gateway, row->since, is_mine(row->claim) || is_living(row->claim, now)};
}

Counters Ownership::counters() const {
  return {{"fleet_malformed", malformed_},
          {"fleet_void", void_claims_},
          {"fleet_roams_in", roams_in_},
          {"fleet_roams_out", roams_out_},
          {"fleet_commands_dropped", turns_.dropped()}};
}

void Ownership::publish(std::string topic, const Body& body, Qos qos) {
  actions_.push(PublishNow{{std::move(topic), to_bytes(encode(life_, body)), qos, false}});
}

void Ownership::notice(Severity severity, std::string text, const std::string& robot) {
  actions_.push(Notice{severity, std::move(text), robot});
}

}  // namespace slamgw::fleet
