// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/ownership.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

/// Contract: at most two beats a second. In a large fleet fewer, so that a gateway hears 200.
constexpr milliseconds shortest_period{500};
constexpr milliseconds period_per_gateway{5};
/// An answer takes two ways through the broker, of which each may take a second in a busy cluster.
constexpr milliseconds sign_patience{3000};
constexpr int sign_round_trips = 4;
constexpr milliseconds look_interval{50};
constexpr milliseconds listening{1000};
/// A broker may take half a second for each subscription.
constexpr std::chrono::seconds longest_look{10};
constexpr milliseconds longest_joining{3000};
constexpr std::chrono::seconds asleep_after{60};
/// A gateway that is `online` and has said nothing for so long is gone, or cut off.
constexpr std::chrono::hours silent_after{1};
constexpr std::size_t max_wills = 16;  // of one robot
constexpr std::chrono::minutes forget_interval{5};
constexpr milliseconds ask_interval{2000};
constexpr milliseconds table_interval{20};
/// Retained states that answer one subscription come within this time of each other.
constexpr milliseconds state_spread{200};
/// Ten times what a gateway says in its state; a larger one is not of a gateway.
constexpr std::size_t max_state_octets = 4096;

std::int64_t to_ms(TimePoint time) {
  return std::chrono::duration_cast<milliseconds>(time.time_since_epoch()).count();
}

}  // namespace

Ownership::Ownership(FleetTopics topics, Settings settings, LocalRobots local_robots)
    : settings_(settings),
      local_robots_(std::move(local_robots)),
      membership_(std::move(topics), settings.process),
      is_looking_(settings.enabled == Enabled::yes) {}

void Ownership::on_broker_link(bool is_up, const Now& now, bool is_session_kept) {
  is_link_up_ = is_up;
  is_session_kept_ = is_up && is_session_kept;
  is_muted_ = false;
  was_ever_echoed_ = false;
  // Nothing waits for the broker.
  if (!is_up && is_alone() && looked_) end_look(now.mono);
  if (settings_.enabled == Enabled::no) unsubscribe_stale();
  if (!is_up || settings_.enabled == Enabled::no) return;
  subscribe(membership_.topics.state_filter());
  if (is_alone() && settings_.enabled == Enabled::automatic) {
    // Commands for robots that nobody knows have an outcome, too.
    subscribe(membership_.topics.command_filter());
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
  if (!looked_ || filter != membership_.topics.state_filter()) return;
  if (answer != SubscribeAnswer::granted) return end_look(now.mono);
  if (!std::exchange(is_state_answered_, true)) looked_ = std::min(*looked_, now.mono + listening);
}

/// A broker that kept this gateway's session has sent commands that others have taken meanwhile,
/// and what they said: both are known by now.
void Ownership::end_look(TimePoint now) {
  is_looking_ = false;
  has_looked_ = has_looked_ || is_link_up_;
  looked_.reset();
  decide_alone(now);
  if (has_looked_) commands_.tell_outcomes(now);
  unsubscribe_stale();
}

/// What an earlier process has subscribed for company. A broker that kept its session would send
/// this gateway commands of other gateways' robots.
void Ownership::unsubscribe_stale() {
  if (!std::exchange(is_session_kept_, false)) return;
  const FleetTopics& topics = membership_.topics;
  for (const std::string& filter :
       {topics.all_filter(), topics.own_filter(), topics.command_filter(), topics.outcome_filter(),
        topics.state_filter()}) {
    if (!subscribed_.contains(filter)) membership_.actions.push(UnsubscribeFleet{filter});
  }
}

/// Nobody else is about: what waited for the others waits no longer.
void Ownership::decide_alone(TimePoint now) {
  commands_.decide_alone(now);
  for (auto& [robot, question] : std::exchange(questions_, {}))
    for (Report& will : question.wills) membership_.actions.push(PublishWill{std::move(will)});
}

void Ownership::wake_up(const Now& now) {
  is_looking_ = false;
  has_looked_ = true;
  look_again_.reset();
  looked_.reset();
  // The commands first: who hears the others and not the commands would miss what they leave to it.
  const FleetTopics& topics = membership_.topics;
  // A gateway that was alone asks for them once more, so that the core looks again at robots' own
  // filters.
  if (is_alone()) subscribed_.erase(topics.command_filter());
  for (const std::string& filter : {topics.command_filter(), topics.all_filter(),
                                    topics.own_filter(), topics.outcome_filter()}) {
    subscribe(filter);
  }
  last_company_ = woken_ = now.mono;
  next_beat_ = now.mono;
  if (is_alone() || membership_.lease.is_life_over(now.mono)) begin_life(now.mono);
}

/// The core asks for it again at each connection.
void Ownership::subscribe(const std::string& filter) {
  if (subscribed_.insert(filter).second) membership_.actions.push(SubscribeFleet{filter});
}

void Ownership::begin_life(TimePoint now) {
  membership_.phase = Phase::joining;
  membership_.lease.begin_life(now);
  claims_.begin_life();
  commands_.begin_life();
  for (auto& [robot, question] : questions_) question.asked.reset();
}

void Ownership::fall_asleep(std::string why, TimePoint now) {
  membership_.phase = Phase::alone;
  // One that is `online` and silent may be cut off: if it comes back, its beats wake this one up.
  const bool is_somebody_silent = !states_.empty() && !is_muted_;
  if (is_somebody_silent) look_again_ = now + silent_after;
  const FleetTopics& topics = membership_.topics;
  for (const std::string& filter : {topics.all_filter(), topics.own_filter(),
                                    topics.command_filter(), topics.outcome_filter()}) {
    if (is_somebody_silent && filter == topics.all_filter()) continue;
    if (subscribed_.erase(filter) > 0) membership_.actions.push(UnsubscribeFleet{filter});
  }
  if (!is_muted_) subscribe(topics.command_filter());
  for (const auto& [robot, is_online] : local_robots_())
    if (!claims_.is_held(robot)) membership_.actions.push(TakeOverRobot{robot, {}, {}});
  claims_.forget_all();
  membership_.peers = {};
  decide_alone(now);
  commands_.forget_owed();
  commands_.tell_outcomes(now);
  membership_.notice(Severity::notice, std::move(why));
}

void Ownership::on_other_gateway(const std::string& gateway, const Now& now) {
  last_company_ = now.mono;
  if (!is_alone() || settings_.enabled != Enabled::automatic || !is_link_up_ || is_muted_) return;
  membership_.notice(Severity::notice,
                     fmt::format("gateway '{}' is on this broker too: from now on they agree who "
                                 "serves which robot (fleet.enabled)",
                                 gateway));
  wake_up(now);
}

// --- Time ----------------------------------------------------------------------------------------

bool Ownership::is_busy() const {
  return membership_.phase == Phase::joining || claims_.is_busy() || !questions_.empty() ||
         commands_.is_busy();
}

std::optional<TimePoint> Ownership::deadline() const {
  if (!is_link_up_) return std::nullopt;
  if (is_alone()) return earlier(looked_, look_again_);
  return is_busy() ? std::min(next_beat_, last_look_ + look_interval) : next_beat_;
}

void Ownership::on_deadline(const Now& now) {
  if (!is_link_up_) return;
  if (is_alone()) {
    if (looked_ && now.mono >= *looked_) end_look(now.mono);
    if (look_again_ && now.mono >= *look_again_) wake_up(now);
    return;
  }
  last_look_ = now.mono;
  if (membership_.lease.is_life_over(now.mono)) begin_life(now.mono);
  if (now.mono >= next_beat_) {
    send_beat(now.mono);
    commands_.end_overdue(now.mono);
    forget_the_dead(now.mono);
    if (!keep_company(now.mono)) return;
  }
  if (membership_.phase == Phase::joining) finish_joining(now);
  claims_.on_deadline(now);
  decide_won(now.mono);
  commands_.decide(now.mono);
  look_at_questions(now);
  commands_.tell_outcomes(now.mono);
}

/// False when this gateway is alone from now on.
bool Ownership::keep_company(TimePoint now) {
  const bool is_company = std::ranges::any_of(
      states_, [&](const auto& each) { return now - each.second.heard < silent_after; });
  if (membership_.peers.count_alive(now) > 0 || is_company) last_company_ = now;
  if (settings_.enabled == Enabled::automatic && now - last_company_ >= asleep_after) {
    fall_asleep("no other gateway is about any more; this one serves every robot", now);
  } else if (settings_.enabled == Enabled::automatic && is_unheard(now)) {
    // With `true` it goes on trying and serves nobody: the operator has asked for one owner.
    is_muted_ = true;
    fall_asleep(
        fmt::format("the broker gives back nothing of what this gateway writes under fleet/. "
                    "Its access control list needs, for this gateway's user: {} "
                    "(docs/fleet.md). Until the next connection this gateway serves every robot "
                    "that it hears, as if it were alone",
                    membership_.topics.rights()),
        now);
  }
  return !is_alone();
}

std::vector<MissingRight> Ownership::missing_rights(TimePoint now) const {
  const bool tries = is_link_up_ && !is_alone();
  if (!is_muted_ && !(tries && is_unheard(now))) return {};
  return {{"other gateways do not hear this one: its own messages under fleet/ do not come back",
           membership_.topics.rights()}};
}

Duration Ownership::period() const {
  const auto gateways = static_cast<int>(membership_.peers.all().size()) + 1;
  return std::max<Duration>(shortest_period, period_per_gateway * gateways);
}

void Ownership::send_beat(TimePoint now) {
  const Duration wait = period();
  const auto digest = membership_.table.digest_of(membership_.me, membership_.lease.life());
  const auto period_ms = std::chrono::duration_cast<milliseconds>(wait).count();
  membership_.publish(
      membership_.topics.all(),
      Beat{to_ms(now), static_cast<std::uint32_t>(period_ms), digest.count, digest.hash,
           static_cast<std::uint64_t>(
               std::chrono::duration_cast<milliseconds>(membership_.lease.up(now)).count())},
      Qos::at_most_once);
  next_beat_ = now + wait;
}

bool Ownership::is_in_step(TimePoint now) const {
  return std::ranges::all_of(membership_.peers.all(), [&](const auto& each) {
    const auto& [gateway, peer] = each;
    return now >= peer.alive_until ||
           membership_.table.digest_of(gateway, peer.life) == peer.digest;
  });
}

void Ownership::finish_joining(const Now& now) {
  const Duration since = now.mono - membership_.lease.joined();
  if (!is_leased(now.mono) || since < std::max<Duration>(listening, period() * 2)) return;
  if (!is_in_step(now.mono) && since < longest_joining + period() * 2) return;
  membership_.phase = Phase::member;
  claims_.join(local_robots_(), now);
}

void Ownership::forget_the_dead(TimePoint now) {
  if (now - forgotten_at_ < forget_interval) return;
  forgotten_at_ = now;
  membership_.peers.forget_dead(now);
  claims_.forget_the_dead(now);
}

// --- Robots --------------------------------------------------------------------------------------

void Ownership::on_heard(const std::string& robot, const Now& now) {
  if (is_alone()) return;
  questions_.erase(robot);
  claims_.on_heard(robot, now);
}

void Ownership::on_heard_too(const std::string& robot, std::optional<SignalLevel> level,
                             const Now& now) {
  questions_.erase(robot);
  claims_.on_heard_too(robot, level, now);
}

bool Ownership::may_serve(const std::string& robot, TimePoint now) const {
  if (settings_.enabled == Enabled::no) return true;
  return may_act_for(robot, now) && (!is_alone() || (has_looked_ && !is_looking_));
}

void Ownership::on_given_up(const std::string& robot, const Claim& to, Bytes session,
                            const Now& now) {
  claims_.on_given_up(robot, to, std::move(session), now.mono);
}

void Ownership::on_command(BrokerMessage message, std::string robot, std::string type,
                           const Now& now) {
  if (!is_shared() || (message.retain && speaks_for(robot, now.mono))) {
    membership_.actions.push(CarryOut{std::move(message)});
    return;
  }
  const bool is_of_gateway =
      robot == membership_.me || states_.contains(robot) || membership_.peers.find(robot);
  if (message.retain || (type == "probe" && is_of_gateway)) return;  // it tries its rights
  commands_.add(std::move(message), std::move(robot), std::move(type), now);
}

void Ownership::on_own_outcome(BrokerMessage outcome, Duration after, const Now& now) {
  commands_.on_own_outcome(std::move(outcome), after, now.mono);
  if (!is_alone() || has_looked_) commands_.tell_outcomes(now.mono);
}

void Ownership::on_outcome(const std::string& gateway, const std::string& robot,
                           const std::string& type, const Now& now) {
  commands_.on_outcome(gateway, robot, type, now.mono);
}

void Ownership::on_will(Report will, const Now& now) {
  if (!is_shared()) {
    membership_.actions.push(PublishWill{std::move(will)});
    return;
  }
  Question& question = questions_[will.robot];
  if (question.wills.size() < max_wills) question.wills.push_back(std::move(will));
  look_at_questions(now);
}

void Ownership::look_at_questions(const Now& now) {
  if (!membership_.may_act(now.mono)) return;
  for (auto each = questions_.begin(); each != questions_.end();) {
    const bool is_over = !speaks_for(each->first, now.mono) || is_answered(each->second, now);
    const bool is_lost = each->second.asked && !each->second.echoed &&
                         now.mono - *each->second.asked >= sign_patience;
    if (!is_over && (!each->second.asked || is_lost))
      ask_for_sign(each->first, each->second, now.mono);
    each = is_over ? questions_.erase(each) : std::next(each);
  }
}

void Ownership::ask_for_sign(const std::string& robot, Question& question, TimePoint now) {
  question.asked = now;
  question.echoed.reset();
  const auto heard = claims_.heard_at(robot);
  const Duration silent = heard ? now - *heard : Duration(1h);
  membership_.tell_all(AskForSign{
      robot, static_cast<std::uint64_t>(std::chrono::duration_cast<milliseconds>(silent).count())});
}

/// A will is published when nobody has heard the robot since, and this gateway could have learned
/// of it.
bool Ownership::is_answered(Question& question, const Now& now) {
  if (!question.asked || !question.echoed) return false;
  const Duration enough =
      std::max<Duration>(sign_patience, (*question.echoed - *question.asked) * sign_round_trips);
  if (now.mono - *question.asked < enough) return false;
  for (Report& will : question.wills) membership_.actions.push(PublishWill{std::move(will)});
  return true;
}

/// A robot that has just become this gateway's may have commands waiting.
void Ownership::decide_won(TimePoint now) {
  if (claims_.take_has_won()) commands_.decide(now);
}

// --- What the broker brings ----------------------------------------------------------------------

void Ownership::on_gateway_state(const BrokerMessage& message, std::string_view gateway,
                                 const Now& now) {
  if (gateway == membership_.me) {
    // Retained, whatever it says: the broker answers this gateway's subscription with it, and other
    // states come at the same time. A live one says nothing about the others.
    if (message.retain && looked_) {
      is_state_answered_ = true;
      looked_ = std::min(*looked_, now.mono + state_spread);
    }
    return;
  }
  if (message.payload.size() > max_state_octets) return;
  const auto json =
      nlohmann::json::parse(message.payload.begin(), message.payload.end(), nullptr, false);
  const bool is_online = json.is_object() && json.value("state", nlohmann::json{}) == "online";
  const std::string id(gateway);
  if (!is_online) {
    states_.erase(id);
  } else if (states_.size() < Peers::max_peers) {
    const auto text = [&](const char* key) {
      return json.contains(key) && json[key].is_string() ? json[key].get<std::string>() : "";
    };
    states_[id] = {text("version"), text("since"), now.mono};
    on_other_gateway(id, now);
  }
}

bool Ownership::on_broker_message(const BrokerMessage& message, const Now& now) {
  if (settings_.enabled == Enabled::no) return false;
  if (const auto gateway = membership_.topics.gateway_of_state(message.topic)) {
    on_gateway_state(message, *gateway, now);
    return false;
  }
  if (const auto sender = membership_.topics.sender(message.topic)) {
    if (message.retain) return true;  // nobody of us retains: a mistake or a forgery
    if (const auto read = decode(*sender, message.payload)) {
      on_fleet_message(*read, now);
    } else {
      on_malformed(*sender, now.mono);
    }
    return true;
  }
  const auto outcome = membership_.topics.outcome(message.topic);
  if (!outcome) return false;
  const auto json =
      nlohmann::json::parse(message.payload.begin(), message.payload.end(), nullptr, false);
  if (json.is_object() && json.contains("type") && json["type"].is_string())
    on_outcome(std::string(outcome->gateway), std::string(outcome->robot), json["type"], now);
  return false;
}

void Ownership::on_malformed(std::string_view sender, TimePoint now) {
  ++malformed_;
  if (const auto count = malformed_throttle_.on_event(now)) {
    membership_.notice(
        Severity::warning,
        fmt::format("{} messages under fleet/ in the name of '{}' are no fleet messages; who may "
                    "write there?",
                    *count, sender));
  }
}

void Ownership::on_fleet_message(const FleetMessage& message, const Now& now) {
  const bool is_own = message.sender == membership_.me;
  if (!is_own) on_other_gateway(message.sender, now);
  if (is_alone()) return;
  if (is_own && message.life != life()) return on_foreign_life(message, now.mono);
  const bool is_beat = std::holds_alternative<Beat>(message.body);
  const bool is_news = std::holds_alternative<Taken>(message.body);  // true even of the dead
  if (!is_own && !is_beat && !is_news &&
      !membership_.peers.is_alive(message.sender, message.life, now.mono)) {
    ++void_claims_;  // a forgery, or old; if it is neither, the next digest tells
    return;
  }
  std::visit([&](const auto& body) { handle(message.sender, message.life, body, now); },
             message.body);
}

/// Of a former life, or of another process. A broker that kept the session of this gateway's former
/// process delivers what that one has said, but no beats (QoS 0), and not one after the other.
void Ownership::on_foreign_life(const FleetMessage& message, TimePoint now) {
  const bool is_beat = std::holds_alternative<Beat>(message.body);
  if (!is_beat || (message.life >> 16U) == (life() >> 16U)) return;
  const bool is_second = std::exchange(rival_, message.life) == message.life;
  if (is_second && rivals_.on_event(now))
    membership_.notice(Severity::error, "another process uses this gateway.id on this broker");
}

void Ownership::handle(const std::string& sender, Life life, const Beat& beat, const Now& now) {
  if (sender == membership_.me) {
    if (membership_.lease.on_own_beat(beat, now.mono)) was_ever_echoed_ = true;
  } else if (membership_.peers.on_beat(sender, life, beat, now.mono)) {
    compare_digest(sender, life, now.mono);
  }
}

/// One difference may be a claim that overtook the beat; two in a row are a claim that was lost.
void Ownership::compare_digest(const std::string& gateway, Life life, TimePoint now) {
  Peers::Peer& peer = *membership_.peers.find(gateway);
  if (membership_.table.digest_of(gateway, life) == peer.digest) {
    peer.mismatches = 0;
    return;
  }
  const unsigned enough = membership_.phase == Phase::joining ? 1 : 2;
  if (++peer.mismatches < enough || (peer.asked_at && now - *peer.asked_at < ask_interval)) return;
  peer.asked_at = now;
  membership_.publish(membership_.topics.to(gateway), AskTable{});
}

void Ownership::handle(const std::string& sender, Life, const AskTable&, const Now& now) {
  if (sender == membership_.me || (table_told_ && now.mono - *table_told_ < table_interval)) return;
  table_told_ = now.mono;
  claims_.tell_table(membership_.topics.to(sender));
}

void Ownership::handle(const std::string& sender, Life, const Hears& hears, const Now& now) {
  if (sender != membership_.me) claims_.on_hears(sender, hears, now);
}

void Ownership::handle(const std::string& sender, Life life, const Table& table, const Now& now) {
  claims_.on_table(sender, life, table, now);
  decide_won(now.mono);
}

void Ownership::handle(const std::string& sender, Life life, const ClaimRobot& claim,
                       const Now& now) {
  if (sender == membership_.me) {
    claims_.on_own_claim(claim.robot, claim.epoch, now);
  } else {
    claims_.on_claim(claim.robot, {claim.epoch, sender, life}, claim.from, now);
  }
  decide_won(now.mono);
}

void Ownership::handle(const std::string& sender, Life life, const Release& release,
                       const Now& now) {
  if (sender == membership_.me) return;
  commands_.on_release(sender, life, release, now.mono);
  claims_.on_release(sender, release, now);
  decide_won(now.mono);
}

void Ownership::handle(const std::string& sender, Life life, const Taken& taken, const Now& now) {
  if (sender == membership_.me) return commands_.on_own_taken(taken, now);
  commands_.on_taken(sender, life, taken, now.mono);
}

void Ownership::handle(const std::string& sender, Life, const AskForSign& ask, const Now& now) {
  if (sender == membership_.me) {
    const auto question = questions_.find(ask.robot);
    if (question != questions_.end() && question->second.asked && !question->second.echoed)
      question->second.echoed = now.mono;
    return;
  }
  const auto heard = claims_.heard_at(ask.robot);
  if (!heard || now.mono - *heard >= milliseconds(ask.silent_ms)) return;
  membership_.publish(membership_.topics.to(sender), Heard{ask.robot});
  claims_.on_question(ask.robot, sender, now);
}

void Ownership::handle(const std::string& sender, Life, const Heard& heard, const Now&) {
  if (sender != membership_.me) questions_.erase(heard.robot);
}

// --- For operators -------------------------------------------------------------------------------

std::optional<Ownership::Place> Ownership::place_of(const std::string& robot, TimePoint now) const {
  const auto* row = membership_.table.find(robot);
  if (!row) return std::nullopt;
  return Place{row->claim.gateway, row->since,
               membership_.is_mine(row->claim) || membership_.is_living(row->claim, now)};
}

Counters Ownership::counters() const {
  return {{"fleet_malformed", malformed_},
          {"fleet_void", void_claims_},
          {"fleet_roams_in", claims_.roams_in()},
          {"fleet_roams_out", claims_.roams_out()},
          {"fleet_commands_dropped", commands_.dropped()}};
}

}  // namespace slamgw::fleet
