// SPDX-License-Identifier: Apache-2.0
// What other gateways say, and what of our own comes back. Time, claims and commands of our own are
// in ownership.cpp.
#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <set>

#include "daemon/fleet/ownership.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

constexpr milliseconds ask_interval{2000};
constexpr milliseconds table_interval{20};
/// Retained states that answer one subscription come within this time of each other.
constexpr milliseconds state_spread{200};
/// A robot that was heard so lately may be claimed once more when a greater claim turns up.
constexpr milliseconds fresh{3000};
/// Ten times what a gateway says in its state; a larger one is not of a gateway.
constexpr std::size_t max_state_octets = 4096;

}  // namespace

void Ownership::on_gateway_state(const BrokerMessage& message, std::string_view gateway,
                                 const Now& now) {
  if (gateway == me_) {
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
    states_[id] = {text("version"), text("since")};
    on_other_gateway(id, now);
  }
}

bool Ownership::on_broker_message(const BrokerMessage& message, const Now& now) {
  if (settings_.enabled == Enabled::no) return false;
  if (const auto gateway = topics_.gateway_of_state(message.topic)) {
    on_gateway_state(message, *gateway, now);
    return *gateway != me_;
  }
  if (const auto sender = topics_.sender(message.topic)) {
    if (message.retain) return true;  // nobody of us retains: a mistake or a forgery
    if (const auto read = decode(*sender, message.payload)) {
      on_fleet_message(*read, now);
    } else {
      on_malformed(*sender, now.mono);
    }
    return true;
  }
  const auto outcome = topics_.outcome(message.topic);
  if (!outcome) return false;
  const auto json =
      nlohmann::json::parse(message.payload.begin(), message.payload.end(), nullptr, false);
  if (json.is_object() && json.contains("type") && json["type"].is_string())
    on_outcome(std::string(outcome->gateway), std::string(outcome->robot), json["type"], now);
  return true;
}

void Ownership::on_malformed(std::string_view sender, TimePoint now) {
  ++malformed_;
  if (const auto count = malformed_throttle_.on_event(now)) {
    notice(
        Severity::warning,
        fmt::format("{} messages under fleet/ in the name of '{}' are no fleet messages; who may "
                    "write there?",
                    *count, sender));
  }
}

void Ownership::on_fleet_message(const FleetMessage& message, const Now& now) {
  const bool is_own = message.sender == me_;
  if (!is_own) on_other_gateway(message.sender, now);
  if (phase_ == Phase::alone) return;
  if (is_own && message.life != life_) {
    if ((message.life >> 16U) != (life_ >> 16U))
      if (const auto count = restless_.on_event(now.mono); count)
        notice(Severity::error, "another process uses this gateway.id on this broker");
    return;
  }
  const bool is_beat = std::holds_alternative<Beat>(message.body);
  const bool is_news = std::holds_alternative<Taken>(message.body);  // true even of the dead
  if (!is_own && !is_beat && !is_news && !peers_.is_alive(message.sender, message.life, now.mono)) {
    ++void_claims_;  // a forgery, or old; if it is neither, the next digest tells
    return;
  }
  std::visit([&](const auto& body) { handle(message.sender, message.life, body, now); },
             message.body);
}

void Ownership::handle(const std::string& sender, Life life, const Beat& beat, const Now& now) {
  if (sender == me_) return on_own_beat(beat, now.mono);
  if (peers_.on_beat(sender, life, beat, now.mono)) compare_digest(sender, life, now.mono);
}

/// One difference may be a claim that overtook the beat; two in a row are a claim that was lost.
void Ownership::compare_digest(const std::string& gateway, Life life, TimePoint now) {
  Peers::Peer& peer = *peers_.find(gateway);
  if (table_.digest_of(gateway, life) == peer.digest) {
    peer.mismatches = 0;
    return;
  }
  const unsigned enough = phase_ == Phase::joining ? 1 : 2;
  if (++peer.mismatches < enough || (peer.asked_at && now - *peer.asked_at < ask_interval)) return;
  peer.asked_at = now;
  publish(topics_.to(gateway), AskTable{}, Qos::at_least_once);
}

void Ownership::handle(const std::string& sender, Life, const AskTable&, const Now& now) {
  if (sender == me_ || (table_told_ && now.mono - *table_told_ < table_interval)) return;
  table_told_ = now.mono;
  tell_table(topics_.to(sender));
}

void Ownership::tell_table(const std::string& topic) {
  Table table;
  for (const auto& [robot, row] : table_.rows()) {
    if (!is_mine(row.claim)) continue;
    if (table.rows.size() == max_table_rows) {
      table.upto = table.rows.back().robot;
      publish(topic, table, Qos::at_least_once);
      table = {table.upto, {}, {}};
    }
    table.rows.push_back({robot, row.claim.epoch});
  }
  publish(topic, table, Qos::at_least_once);
}

void Ownership::handle(const std::string& sender, Life life, const Table& table, const Now& now) {
  if (sender == me_) {
    for (const auto& [robot, epoch] : table.rows) on_own_claim(robot, epoch, now);
    return;
  }
  std::set<std::string_view> told;
  for (const auto& [robot, epoch] : table.rows) {
    told.insert(robot);
    merge(robot, {epoch, sender, life}, {}, now);
  }
  std::vector<std::string> dropped;
  for (auto row = table_.rows().upper_bound(table.after); row != table_.rows().end(); ++row) {
    const auto& [robot, entry] = *row;
    if (!table.upto.empty() && robot > table.upto) break;
    const bool is_theirs = entry.claim.gateway == sender && entry.claim.life == life;
    if (is_theirs && !told.contains(robot)) dropped.push_back(robot);
  }
  for (const std::string& robot : dropped) table_.erase(robot);
}

void Ownership::handle(const std::string& sender, Life life, const ClaimRobot& claim,
                       const Now& now) {
  if (sender == me_) return on_own_claim(claim.robot, claim.epoch, now);
  merge(claim.robot, {claim.epoch, sender, life}, claim.from, now);
}

void Ownership::merge(const std::string& robot, const Claim& claim, const std::string& from,
                      const Now& now) {
  const auto* known = table_.find(robot);
  const std::optional<Claim> row = known ? std::optional(known->claim) : std::nullopt;
  const bool is_void = row && !is_mine(*row) && !is_living(*row, now.mono);
  if (row && !is_void && claim <= *row) return on_lesser_claim(robot, claim, *row, from, now);
  const auto claiming = claiming_.find(robot);
  // Who asks this gateway to make way has heard the robot after it had this gateway's claim.
  const bool was_behind =
      claiming != claiming_.end() && row && claim.epoch > row->epoch && from != me_;
  if (!table_.set(robot, claim, now.wall)) return;
  if (held_.contains(robot) || claiming != claiming_.end()) {
    give_way(robot, claim);
  } else if (from == me_) {
    // The gateway that took the robot over from this one must give way as well.
    const bool has_passed_on = row && row->gateway != claim.gateway && is_living(*row, now.mono);
    release(robot, has_passed_on ? *row : claim, claim.gateway, {});
  }
  const auto heard = heard_.find(robot);
  if (was_behind && heard != heard_.end() && now.mono - heard->second < fresh &&
      is_leased(now.mono))
    claim_unless_guarded(robot, now);
}

void Ownership::on_lesser_claim(const std::string& robot, const Claim& claim, const Claim& row,
                                const std::string& from, const Now& now) {
  if (!is_mine(row)) {
    if (from == me_) release(robot, row, claim.gateway, {});
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
  tell_all(ClaimRobot{robot, row.epoch, {}});
}

void Ownership::handle(const std::string& sender, Life, const Release& release, const Now& now) {
  const auto found = claiming_.find(release.robot);
  if (sender == me_ || found == claiming_.end()) return;
  Claiming& claiming = found->second;
  const Claim& mine = table_.find(release.robot)->claim;
  if (release.to > mine) {
    if (is_living(release.to, now.mono)) return merge(release.robot, release.to, {}, now);
  } else if (release.to != mine && is_living(release.to, now.mono) &&
             !claiming.released.contains(release.to.gateway)) {
    claiming.awaited[release.to.gateway] = release.to.life;  // made way for that one
  }
  claiming.released.insert(sender);
  claiming.awaited.erase(sender);
  claiming.was_released = true;
  if (!release.session.empty() && release.to == mine) claiming.session = release.session;
  if (is_won(claiming, now.mono)) own(release.robot, now);
}

void Ownership::handle(const std::string& sender, Life life, const Taken& taken, const Now& now) {
  if (sender == me_) return on_own_taken(taken, now);
  turns_.on_taken(sender, life, taken, me_, now.mono);
}

void Ownership::handle(const std::string& sender, Life, const AskForSign& ask, const Now& now) {
  if (sender == me_) {
    const auto question = questions_.find(ask.robot);
    if (question != questions_.end() && question->second.asked) question->second.is_echoed = true;
    return;
  }
  const auto heard = heard_.find(ask.robot);
  if (heard == heard_.end() || now.mono - heard->second >= milliseconds(ask.silent_ms)) return;
  publish(topics_.to(sender), Heard{ask.robot}, Qos::at_least_once);
  if (phase_ != Phase::member || !is_leased(now.mono)) return;
  const auto* row = table_.find(ask.robot);
  if (row && row->claim.gateway == sender && !claiming_.contains(ask.robot)) claim(ask.robot, now);
}

void Ownership::handle(const std::string& sender, Life, const Heard& heard, const Now&) {
  if (sender != me_) questions_.erase(heard.robot);
}

}  // namespace slamgw::fleet
