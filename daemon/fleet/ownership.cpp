// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/ownership.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/fleet/hash.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

/// At most two beats a second. In a large fleet fewer, so that a gateway hears 200.
constexpr milliseconds shortest_period{500};
constexpr milliseconds period_per_gateway{5};
/// How often claims, commands and wills that wait are checked.
constexpr milliseconds busy_interval{50};
constexpr milliseconds listening{1000};
/// A broker may take half a second for each subscription.
constexpr std::chrono::seconds longest_discovery{10};
constexpr milliseconds longest_joining{3000};
constexpr std::chrono::seconds asleep_after{60};
/// One that is `online` and silent may have been cut off.
constexpr std::chrono::hours rediscovery_interval{1};
constexpr std::chrono::minutes forget_interval{5};
constexpr milliseconds ask_interval{2000};
/// Who asks for this gateway's claims gets them. If more ask within this time, all get them at
/// once: when a broker is whole again, half the fleet asks the other half.
constexpr milliseconds table_interval{200};
/// Retained states that answer one subscription come within this time of each other.
constexpr milliseconds state_spread{200};

}  // namespace

Ownership::Ownership(FleetTopics topics, Settings settings, LocalRobots local_robots)
    : settings_(settings),
      local_robots_(std::move(local_robots)),
      membership_(std::move(topics), settings.process),
      is_discovering_(settings.joins_at_once()) {}

void Ownership::on_broker_link(bool is_up, const Now& now, bool is_session_kept) {
  is_link_up_ = is_up;
  is_muted_ = was_echoed_ = false;
  online_.on_link_change();
  if (is_up) {
    subscriptions_.on_link_up(is_session_kept, now.mono);
    commands_.on_link_up(is_session_kept, now.mono);
  } else {
    subscriptions_.on_link_down();
    link_lost_ = now.mono;
    commands_.on_link_lost(now.mono, !is_alone() && subscriptions_.are_answered(now.mono));
  }
  // Nothing waits for the broker.
  if (!is_up && is_alone() && discovery_ends_) end_discovery(now.mono);
  if (settings_.enabled == Enabled::no) subscriptions_.unsubscribe_stale();
  if (!is_up || settings_.enabled == Enabled::no) return;
  subscriptions_.subscribe(membership_.topics.state_filter(), now.mono);
  if (is_alone() && !settings_.joins_at_once()) {
    // Commands for robots that nobody knows have an outcome, too.
    subscriptions_.subscribe(membership_.topics.command_filter(), now.mono);
    is_discovering_ = true;
    is_state_answered_ = false;
    discovery_ends_ = now.mono + longest_discovery;
    return;
  }
  wake_up(now);
}

void Ownership::on_subscribe_result(const std::string& filter, SubscribeAnswer answer,
                                    const Now& now) {
  subscriptions_.on_answer(filter, answer);
  if (!discovery_ends_ || filter != membership_.topics.state_filter()) return;
  if (answer != SubscribeAnswer::granted) return end_discovery(now.mono);
  if (!std::exchange(is_state_answered_, true))
    discovery_ends_ = std::min(*discovery_ends_, now.mono + listening);
}

/// By now a broker that kept this gateway's session has sent the commands that others have taken
/// meanwhile, and their messages.
void Ownership::end_discovery(TimePoint now) {
  is_discovering_ = false;
  discovery_ends_.reset();
  if (is_link_up_ && !std::exchange(has_discovered_, true)) take_over_local_robots();
  decide_alone(now);
  if (has_discovered_) commands_.publish_outcomes(now);
  subscriptions_.unsubscribe_stale();
}

/// No other gateway is on this broker: decides commands and wills that waited for the others. Not
/// when the connection ended before discovery did: others may have dealt with the commands by now,
/// and robots of an earlier process may live at other gateways.
void Ownership::decide_alone(TimePoint now) {
  if (!has_discovered_) return;
  commands_.decide_alone(now);
  wills_.publish_all();
}

/// A broker that has just lost a node may not tell a gateway that starts who else is `online`.
void Ownership::remember_others(bool are_about) {
  const bool is_news = settings_.enabled == Enabled::automatic &&
                       std::exchange(settings_.were_others_about, are_about) != are_about;
  if (is_news) membership_.actions.push(RememberOthers{are_about});
}

void Ownership::wake_up(const Now& now) {
  is_discovering_ = false;
  has_discovered_ = true;
  rediscovery_due_.reset();
  discovery_ends_.reset();
  subscriptions_.subscribe_to_others(is_alone(), now.mono);
  last_company_ = woken_ = next_beat_ = now.mono;
  is_first_beat_ = true;
  if (is_alone() || membership_.lease.is_life_over(now.mono)) {
    begin_life(now.mono);
  } else {
    membership_.peers.on_own_gap(link_lost_, now.mono);
  }
  if (!subscriptions_.is_session_kept()) membership_.lease.on_gap(now.mono);
}

void Ownership::on_stop() {
  is_stopping_ = true;
  commands_.publish_all_outcomes();
  if (is_alone()) wills_.publish_all();
}

void Ownership::begin_life(TimePoint now) {
  membership_.phase = Phase::joining;
  was_echoed_ = false;
  woken_ = now;
  membership_.lease.begin_life(now);
  claims_.begin_life();
  commands_.begin_life();
  table_due_.reset();
  wills_.begin_life();
}

void Ownership::fall_asleep(std::string why, TimePoint now) {
  membership_.phase = Phase::alone;
  membership_.lease.give_up();
  // One that is `online` and silent may be cut off: if it comes back, its beats wake this one up.
  const bool is_somebody_silent = !online_.all().empty() && !is_muted_;
  if (is_somebody_silent) rediscovery_due_ = now + rediscovery_interval;
  subscriptions_.unsubscribe_from_others(/*keeps_beats=*/is_somebody_silent);
  if (!is_muted_) subscriptions_.subscribe(membership_.topics.command_filter(), now);
  take_over_local_robots();
  claims_.forget_all();
  membership_.peers = {};
  decide_alone(now);
  commands_.forget_owed();
  commands_.publish_outcomes(now);
  if (online_.all().empty()) remember_others(false);
  membership_.notice(is_muted_ ? Severity::warning : Severity::notice, std::move(why));
}

/// Nobody else is about.
void Ownership::take_over_local_robots() {
  for (const auto& [robot, is_online] : local_robots_())
    if (!claims_.is_held(robot)) membership_.actions.push(TakeOverRobot{robot, {}, {}});
}

void Ownership::on_other_gateway(const std::string& gateway, const Now& now) {
  last_company_ = now.mono;
  remember_others(true);
  if (!is_alone() || settings_.enabled != Enabled::automatic || !is_link_up_ || is_muted_) return;
  membership_.notice(Severity::notice,
                     fmt::format("gateway '{}' is on this broker too: from now on they agree who "
                                 "serves which robot (fleet.enabled)",
                                 gateway));
  wake_up(now);
}

// --- Time ----------------------------------------------------------------------------------------

bool Ownership::is_busy() const {
  return membership_.phase == Phase::joining || claims_.is_busy() || !wills_.is_empty() ||
         commands_.is_busy();
}

std::optional<TimePoint> Ownership::deadline() const {
  if (!is_link_up_) return std::nullopt;
  if (is_alone()) return earlier(discovery_ends_, rediscovery_due_);
  const TimePoint next =
      is_busy() ? std::min(next_beat_, last_deadline_ + busy_interval) : next_beat_;
  return earlier(next, table_due_);
}

void Ownership::on_deadline(const Now& now) {
  if (!is_link_up_) return;
  if (is_alone()) {
    if (discovery_ends_ && now.mono >= *discovery_ends_) end_discovery(now.mono);
    if (rediscovery_due_ && now.mono >= *rediscovery_due_) wake_up(now);
    return;
  }
  last_deadline_ = now.mono;
  membership_.lease.look(now.mono);
  if (membership_.lease.is_life_over(now.mono)) begin_life(now.mono);
  if (now.mono >= next_beat_) {
    send_beat(now.mono);
    commands_.end_overdue(now.mono);
    forget_the_dead(now.mono);
    if (online_.take_newcomers(membership_.peers, now.mono) && !is_stopping_)
      membership_.actions.push(AnnounceGateway{});
    if (!keep_company(now.mono)) return;
  }
  if (membership_.phase == Phase::joining) finish_joining(now);
  publish_table_to_all(now.mono);
  claims_.on_deadline(now);
  decide_won(now.mono);
  commands_.decide(now.mono);
  if (!wills_.is_empty())
    wills_.decide(online_.complete_since(membership_.peers, now.mono), now.mono);
  commands_.publish_outcomes(now.mono);
}

/// False when this gateway is alone from now on.
bool Ownership::keep_company(TimePoint now) {
  if (membership_.peers.count_alive(now) > 0 || online_.is_any_about(now)) last_company_ = now;
  if (settings_.enabled == Enabled::automatic && now - last_company_ >= asleep_after) {
    fall_asleep("no other gateway is about any more; this one serves every robot", now);
  } else if (is_unheard(now)) {
    on_unheard(now);
  }
  return !is_alone();
}

/// With `true` it goes on trying and serves nobody: the operator has asked for one owner.
void Ownership::on_unheard(TimePoint now) {
  const bool gives_up = settings_.enabled == Enabled::automatic;
  if (!gives_up && !unheard_.on_event(now)) return;
  std::string text = fmt::format(
      "the broker gives back nothing of what this gateway writes under fleet/. Its access control "
      "list needs, for this gateway's user: {} (docs/fleet.md). Until {}",
      membership_.topics.rights(),
      gives_up ? "the next connection this gateway serves every robot that it hears, as if it were "
                 "alone"
               : "then this gateway carries out no command (fleet.enabled)");
  if (!gives_up) return membership_.notice(Severity::warning, std::move(text));
  is_muted_ = true;
  fall_asleep(std::move(text), now);
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
      Beat{to_clock_ms(now), static_cast<std::uint32_t>(period_ms), digest.count, digest.hash,
           to_age_ms(membership_.lease.up(now)), to_age_ms(membership_.lease.gapless(now))},
      Qos::at_most_once);
  // The second beat comes early: gateways that connect at once, because the broker was restarted,
  // would send all their beats in the same millisecond.
  const bool is_first = std::exchange(is_first_beat_, false);
  next_beat_ = now + wait - milliseconds(is_first ? fnv1a(membership_.me) % period_ms : 0);
}

bool Ownership::is_in_step(TimePoint now) const {
  return std::ranges::all_of(membership_.peers.all(), [&](const auto& each) {
    const auto& [gateway, peer] = each;
    return now >= peer.alive_until ||
           membership_.table.digest_of(gateway, peer.life) == peer.digest;
  });
}

void Ownership::finish_joining(const Now& now) {
  const Duration since = membership_.lease.gapless(now.mono);
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
  wills_.drop(robot);
  if (!is_alone()) claims_.on_heard(robot, now);
}

void Ownership::on_heard_too(const std::string& robot, std::optional<SignalLevel> level,
                             const Now& now) {
  wills_.drop(robot);
  claims_.on_heard_too(robot, level, now);
}

bool Ownership::may_serve(const std::string& robot, TimePoint now) const {
  if (settings_.enabled == Enabled::no) return true;
  return may_act_for(robot, now) && (!is_alone() || (has_discovered_ && !is_discovering_));
}

bool Ownership::may_announce(const std::string& robot, Presence presence, bool has_just_come,
                             TimePoint now) const {
  if (!speaks_for(robot, now)) return false;
  if (presence == Presence::offline) return true;
  if (is_alone()) return has_just_come || !may_be_shared();
  return membership_.phase == Phase::member && !membership_.lease.is_life_over(now);
}

void Ownership::on_given_up(const std::string& robot, const Claim& to, Bytes session,
                            const Now& now) {
  claims_.on_given_up(robot, to, std::move(session), now.mono);
}

void Ownership::on_command(BrokerMessage message, std::string robot, std::string type,
                           const Now& now, bool may_be_copy) {
  if (!is_shared() || (message.retain && speaks_for(robot, now.mono))) {
    membership_.actions.push(CarryOut{std::move(message)});
    return;
  }
  const bool is_of_gateway =
      robot == membership_.me || online_.contains(robot) || membership_.peers.find(robot);
  if (message.retain || (type == "probe" && is_of_gateway)) return;  // it tries its rights
  commands_.add(std::move(message), std::move(robot), std::move(type), now,
                may_be_copy && membership_.phase == Phase::joining);
}

void Ownership::on_own_outcome(BrokerMessage outcome, Duration after, const Now& now) {
  commands_.on_own_outcome(std::move(outcome), after, now.mono);
  if (is_alone() ? has_discovered_ : is_link_up_) commands_.publish_outcomes(now.mono);
}

void Ownership::on_outcome(const std::string& gateway, const std::string& robot,
                           const std::string& type, const Now& now, Duration after) {
  commands_.on_outcome(gateway, robot, type, after, now.mono);
}

void Ownership::on_will(Report will, const Now& now) {
  if (!holds_wills()) {
    membership_.actions.push(PublishWill{std::move(will)});
    return;
  }
  wills_.add(std::move(will));
  wills_.decide(online_.complete_since(membership_.peers, now.mono), now.mono);
}

/// A robot that has just become this gateway's may have commands waiting.
void Ownership::decide_won(TimePoint now) {
  if (claims_.take_has_won()) commands_.decide(now);
}

// --- What the broker brings ----------------------------------------------------------------------

void Ownership::on_gateway_state(const BrokerMessage& message, std::string_view gateway,
                                 const Now& now) {
  if (message.retain) online_.on_retained();
  if (gateway == membership_.me) {
    // Retained, whatever it says: the broker answers this gateway's subscription with it, and other
    // states come at the same time. A live one says nothing about the others.
    if (message.retain && discovery_ends_) {
      is_state_answered_ = true;
      discovery_ends_ = std::min(*discovery_ends_, now.mono + state_spread);
    }
    return;
  }
  const std::string id(gateway);
  if (online_.on_state(id, message.payload, now.mono)) on_other_gateway(id, now);
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
  if (!outcome || commands_.is_heard_again(message, now.mono)) return false;
  if (const auto read = SharedCommands::read(message))
    on_outcome(std::string(outcome->gateway), std::string(outcome->robot), read->type, now,
               read->after);
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
  if (!is_own && !counts(message, now.mono)) {
    ++void_claims_;  // a forgery, or old; if it is neither, the next digest tells
    return;
  }
  std::visit([&](const auto& body) { handle(message.sender, message.life, body, now); },
             message.body);
}

/// Beats and `taken` always count, questions about a robot and their answers (which are not
/// repeated) from a life that may not have sent a beat yet, and all else from living gateways only.
bool Ownership::counts(const FleetMessage& message, TimePoint now) const {
  const Body& body = message.body;
  if (std::holds_alternative<Beat>(body) || std::holds_alternative<Taken>(body)) return true;
  if (std::holds_alternative<AskForSign>(body) || std::holds_alternative<Heard>(body))
    return !membership_.peers.is_over(message.sender, message.life);
  return membership_.peers.is_alive(message.sender, message.life, now);
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

/// It renews the lease when all that others say comes, too: a broker may need half a second for
/// each subscription, and grant the one to beats first.
void Ownership::on_own_beat(const Beat& beat, TimePoint now) {
  if (!Lease::is_possible(beat, now)) return;
  was_echoed_ = has_been_echoed_ = true;
  if (subscriptions_.are_answered(now)) membership_.lease.on_own_beat(beat, now);
}

void Ownership::handle(const std::string& sender, Life life, const Beat& beat, const Now& now) {
  if (sender == membership_.me) return on_own_beat(beat, now.mono);
  const bool was_away = !membership_.peers.is_alive(sender, life, now.mono);
  if (membership_.peers.on_beat(sender, life, beat, now.mono))
    compare_digest(sender, life, was_away, now.mono);
}

/// One difference may be a claim that overtook the beat; two in a row are a claim that was lost.
/// What a gateway has claimed while it was away was lost in any case.
void Ownership::compare_digest(const std::string& gateway, Life life, bool was_away,
                               TimePoint now) {
  Peers::Peer& peer = *membership_.peers.find(gateway);
  if (membership_.table.digest_of(gateway, life) == peer.digest) {
    peer.mismatches = 0;
    return;
  }
  const Duration pause = membership_.table.is_full() ? ask_interval * 30 : ask_interval;
  const unsigned enough = was_away || membership_.phase == Phase::joining ? 1 : 2;
  if (++peer.mismatches < enough || (peer.asked_at && now - *peer.asked_at < pause)) return;
  peer.asked_at = now;
  membership_.publish(membership_.topics.to(gateway), AskTable{});
}

void Ownership::handle(const std::string& sender, Life, const AskTable&, const Now& now) {
  if (sender == membership_.me || table_due_) return;
  if (table_published_ && now.mono - *table_published_ < table_interval) {
    table_due_ = *table_published_ + table_interval;
    return;
  }
  table_published_ = now.mono;
  claims_.publish_table(membership_.topics.to(sender));
}

void Ownership::publish_table_to_all(TimePoint now) {
  if (!table_due_ || now < *table_due_) return;
  table_due_.reset();
  table_published_ = now;
  claims_.publish_table(membership_.topics.all());
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
    wills_.on_own_question(ask.robot, now.mono);
    return;
  }
  const auto heard = claims_.heard_at(ask.robot);
  if (!heard || now.mono - *heard >= milliseconds(ask.silent_ms)) return;
  membership_.publish(membership_.topics.to(sender), Heard{ask.robot});
  claims_.on_question(ask.robot, sender, now);
}

void Ownership::handle(const std::string& sender, Life, const Heard& heard, const Now&) {
  if (sender != membership_.me) wills_.drop(heard.robot);
}

// --- For operators -------------------------------------------------------------------------------

std::optional<Ownership::Place> Ownership::place_of(const std::string& robot, TimePoint now) const {
  const auto row = membership_.table.find(robot);
  if (!row) return std::nullopt;
  return Place{row->claim.gateway, row->since,
               membership_.is_mine(row->claim) || membership_.is_living(row->claim, now)};
}

Counters Ownership::counters() const {
  return {{"fleet_malformed", malformed_},
          {"fleet_void", void_claims_},
          {"fleet_claims_not_kept", claims_.not_kept()},
          {"fleet_roams_in", claims_.roams_in()},
          {"fleet_roams_out", claims_.roams_out()},
          {"fleet_commands_dropped", commands_.dropped()},
          {"lease_lapses", lease_lapses()}};
}

}  // namespace slamgw::fleet
