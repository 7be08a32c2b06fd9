// SPDX-License-Identifier: Apache-2.0
#include "web/server/roster.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <tuple>
#include <utility>

#include "web/server/mirror.hpp"

namespace slamgw::web {
namespace {

using nlohmann::json;

constexpr std::int64_t evidence_period_ms = 30'000;
constexpr std::string_view robots_level = "robots/";

std::string text(const json& document, const char* key) {
  const auto found = document.find(key);
  const auto* value = found == document.end() ? nullptr : found->get_ptr<const std::string*>();
  return value == nullptr ? "" : *value;
}

std::int64_t time_of(const json& document, const char* key) {
  return unix_ms(text(document, key)).value_or(0);
}

SharedText gateway_text(const std::string& topic, const GatewayLife& life) {
  return std::make_shared<const std::string>(
      own_message(topic, fmt::format(R"({{"state":"{}","since":{},"clock_ahead_ms":{}}})",
                                     life.state, life.since_ms, life.clock_ahead_ms)));
}

SharedText robot_text(const std::string& topic, const RobotLife& life) {
  std::string payload = fmt::format(R"({{"state":"{}","since":{},"heard":{},"gateway":)",
                                    life.state, life.since_ms, life.heard_ms);
  append_json_text(payload, life.gateway);
  return std::make_shared<const std::string>(own_message(topic, payload + "}"));
}

/// The highest rank counts: of several gateways, the one that reports the robot as online.
int rank(std::string_view state) {
  return state == "online" ? 3 : state == "asleep" ? 2 : state == "offline" ? 1 : 0;
}

}  // namespace

std::optional<std::int64_t> unix_ms(std::string_view iso8601) {
  int year = 0;
  unsigned month = 0, day = 0;
  int hour = 0, minute = 0;
  double second = 0;
  if (iso8601.size() > 40 ||
      std::sscanf(std::string(iso8601).c_str(), "%4d-%2u-%2uT%2d:%2d:%lf", &year, &month, &day,
                  &hour, &minute, &second) != 6 ||
      month < 1 || month > 12 || !(second >= 0 && second < 61))
    return std::nullopt;
  using namespace std::chrono;
  const sys_days date(std::chrono::year(year) / std::chrono::month(month) / std::chrono::day(day));
  return milliseconds(date.time_since_epoch() + hours(hour) + minutes(minute)).count() +
         static_cast<std::int64_t>(second * 1000 + 0.5);
}

// ---- messages of gateways

void Roster::on_document(const Topics::GatewayTopic& topic, std::string_view payload,
                         std::int64_t at_ms, bool is_retained) {
  if (payload.empty()) return forget(topic.gateway, topic.rest);
  if (gateways_.size() >= max_gateways && !gateways_.contains(topic.gateway)) return;
  json document = json::parse(payload, nullptr, false);
  if (!document.is_object()) document = json::object();
  Gateway& gateway = gateways_[std::string(topic.gateway)];
  // A retained document is not a sign of life, but the gateway's stats are awaited from now on.
  if (!is_retained || gateway.sign_of_life_ms == 0) gateway.sign_of_life_ms = at_ms;
  if (topic.rest == "state") on_state(gateway, document, at_ms, is_retained);
  if (topic.rest == "numbers") on_numbers(topic.gateway, document, at_ms);
  if (topic.rest.starts_with(robots_level))
    on_presence(topic.gateway, topic.rest.substr(robots_level.size()), document, at_ms,
                is_retained);
  const auto uptime = document.find("uptime_s");
  if (topic.rest == "stats" && uptime != document.end() && uptime->is_number_unsigned() &&
      gateway.started_ms > 0)
    gateway.stats.add(gateway.started_ms + uptime->get<std::int64_t>() * 1000 - at_ms);
}

void Roster::on_state(Gateway& gateway, const json& document, std::int64_t at_ms, bool is_old) {
  gateway.state = text(document, "state");
  gateway.state_at_ms = is_old ? 0 : at_ms;
  gateway.started_ms = time_of(document, "since");
  on_clock(gateway, gateway.started_ms, at_ms, is_old);
}

void Roster::on_presence(std::string_view gateway, std::string_view robot, const json& document,
                         std::int64_t at_ms, bool is_old) {
  if (robots_.size() >= max_robots && !robots_.contains(robot)) return;
  Presence& presence = robots_[std::string(robot)].presence[std::string(gateway)];
  presence = {text(document, "state"), text(document, "mesh"), time_of(document, "since"),
              time_of(document, "last_seen"), presence.heard_ms};
  on_clock(gateways_.find(gateway)->second, presence.seen_ms, at_ms, is_old);
  touched_.emplace(robot);
}

void Roster::on_numbers(std::string_view gateway, const json& document, std::int64_t at_ms) {
  const auto robots = document.find("robots");
  if (robots == document.end() || !robots->is_object()) return;
  for (const auto& [id, numbers] : robots->items()) {
    const std::int64_t heard_ms = numbers.is_object() ? time_of(numbers, "last_heard") : 0;
    on_clock(gateways_.find(gateway)->second, heard_ms, at_ms, false);
    const auto robot = robots_.find(id);
    if (heard_ms == 0 || robot == robots_.end()) continue;
    const auto presence = robot->second.presence.find(gateway);
    if (presence == robot->second.presence.end()) continue;
    presence->second.heard_ms = heard_ms;
    touched_.insert(id);
  }
}

void Roster::on_clock(Gateway& gateway, std::int64_t time_ms, std::int64_t at_ms, bool is_old) {
  if (time_ms == 0) return;
  if (is_old)
    gateway.retained_ahead_ms = std::max(gateway.retained_ahead_ms, time_ms - at_ms);
  else
    gateway.documents.add(time_ms - at_ms);
}

void Roster::on_robot_message(std::string_view robot, std::string_view gateway,
                              std::string_view received_at, std::int64_t at_ms) {
  const auto sender = gateways_.find(gateway);
  if (sender == gateways_.end() && !gateway.empty()) return;
  const auto received_ms = sender == gateways_.end() ? std::nullopt : unix_ms(received_at);
  if (const auto known = robots_.find(robot); known != robots_.end())
    known->second.newest = {std::string(received_ms ? gateway : ""), received_ms.value_or(at_ms)};
  if (sender == gateways_.end()) return;
  sender->second.sign_of_life_ms = at_ms;
  if (received_ms) sender->second.messages.add(*received_ms - at_ms);
}

void Roster::forget(std::string_view gateway, std::string_view rest) {
  const auto known = gateways_.find(gateway);
  const bool is_gone = known != gateways_.end() && (rest == "state" || !known->second.state);
  if (is_gone) gateways_.erase(known);
  if (is_gone || rest == "numbers") {
    for (auto& [id, robot] : robots_) {
      const auto presence = robot.presence.find(gateway);
      if (presence == robot.presence.end()) continue;
      presence->second.heard_ms = 0;
      touched_.insert(id);
    }
  }
  if (!rest.starts_with(robots_level)) return;
  const auto robot = robots_.find(rest.substr(robots_level.size()));
  if (robot == robots_.end()) return;
  robot->second.presence.erase(std::string(gateway));
  touched_.insert(robot->first);
  if (robot->second.presence.empty()) robots_.erase(robot);
}

void Roster::on_broker_lost(std::int64_t now_ms) {
  if (broker_lost_ms_ == 0) broker_lost_ms_ = now_ms;
}

void Roster::on_broker_found() {
  gateways_.clear();
  robots_.clear();
  touched_.clear();
  broker_lost_ms_ = 0;
}

// ---- clocks

void Roster::ClockEvidence::add(std::int64_t ahead_ms) {
  periods[0] = std::max(periods[0].value_or(ahead_ms), ahead_ms);
}

void Roster::ClockEvidence::turn(std::int64_t now_ms) {
  if (now_ms - turned_at_ms < evidence_period_ms) return;
  turned_at_ms = now_ms;
  periods[1] = std::exchange(periods[0], std::nullopt);
}

std::optional<std::int64_t> Roster::ClockEvidence::most() const {
  return std::max(periods[0], periods[1]);
}

namespace {

std::int64_t beyond_tolerance(std::int64_t ahead_ms) {
  constexpr std::int64_t minute = 60'000;  // rounds, so that the value does not change all the time
  return std::abs(ahead_ms) < Roster::clock_tolerance_ms ? 0 : ahead_ms / minute * minute;
}

}  // namespace

/// A message is stamped on arrival, so the newest stamp shows the gateway's clock. Other times may
/// be older than a step of the clock: without messages, these prove only that the clock is ahead.
/// Messages that waited on disk look like a clock that is behind, so the stats must agree.
GatewayLife Roster::judge(const Gateway& gateway, std::int64_t now_ms) const {
  GatewayLife life;
  const auto messages = gateway.messages.most();
  const auto stats = gateway.stats.most();
  const auto documents = std::max(gateway.documents.most(), stats);
  const std::int64_t before = std::max(gateway.retained_ahead_ms, gateway.life.clock_ahead_ms);
  const std::int64_t others = std::max(documents.value_or(before), INT64_C(0));
  const std::int64_t behind = stats ? std::max(messages.value_or(0), *stats) : 0;
  life.clock_ahead_ms = beyond_tolerance(!messages       ? others
                                         : *messages > 0 ? *messages
                                                         : std::min(behind, INT64_C(0)));
  if (broker_lost_ms_ > 0) {
    life.since_ms = broker_lost_ms_;
  } else if (gateway.state && *gateway.state != "online") {
    life.state = "gone";
    life.since_ms = gateway.state_at_ms;
  } else if (now_ms - gateway.sign_of_life_ms > silent_after_ms) {
    life.state = "silent";
    life.since_ms = gateway.sign_of_life_ms;
  } else {
    life.state = "online";
    life.since_ms = gateway.state_at_ms;
  }
  return life;
}

/// Converts a gateway's time to this program's clock; 0 when it can't be true.
std::int64_t Roster::local(std::string_view gateway, std::int64_t time_ms,
                           std::int64_t now_ms) const {
  const std::int64_t here = time_ms - this->gateway(gateway).clock_ahead_ms;
  return time_ms == 0 || here > now_ms + clock_tolerance_ms ? 0 : std::min(here, now_ms);
}

RobotLife Roster::judge(const Robot& robot, std::int64_t now_ms) const {
  RobotLife life;
  std::tuple best{-1, INT64_C(-1)};
  for (const auto& [gateway, presence] : robot.presence) {
    const GatewayLife teller = this->gateway(gateway);
    const bool is_current = teller.state == "online" && rank(presence.state) > 0;
    const std::int64_t seen_ms = local(gateway, presence.seen_ms, now_ms);
    life.heard_ms = std::max({life.heard_ms, seen_ms, local(gateway, presence.heard_ms, now_ms)});
    const std::tuple here{is_current ? rank(presence.state) : 0, seen_ms};
    if (here <= best) continue;
    best = here;
    life.gateway = gateway;
    life.mesh = presence.mesh;
    life.state = is_current ? presence.state : "unknown";
    life.since_ms = is_current ? local(gateway, presence.since_ms, now_ms) : teller.since_ms;
    if (!is_current && life.since_ms == 0) life.since_ms = seen_ms;
  }
  return life;
}

// ---- results for pages and metrics

std::map<std::string, SharedText> Roster::update(std::int64_t now_ms) {
  std::map<std::string, SharedText> changes;
  bool has_changed = false;
  for (auto& [id, gateway] : gateways_) {
    for (ClockEvidence* each : {&gateway.messages, &gateway.documents, &gateway.stats})
      each->turn(now_ms);
    const GatewayLife life = judge(gateway, now_ms);
    if (life == gateway.life) continue;
    gateway.life = life;
    has_changed = true;
    const std::string topic = "gateway/" + id;
    changes.emplace(topic, gateway_text(topic, life));
  }
  if (has_changed)
    for (const auto& entry : robots_) touched_.insert(entry.first);
  for (const std::string& id : std::exchange(touched_, {})) {
    const auto robot = robots_.find(id);
    if (robot == robots_.end()) continue;  // no gateway reports this robot any more
    RobotLife life = judge(robot->second, now_ms);
    if (life == robot->second.life) continue;
    robot->second.life = std::move(life);
    const std::string topic = "robot/" + id;
    changes.emplace(topic, robot_text(topic, robot->second.life));
  }
  return changes;
}

std::map<std::string, SharedText> Roster::texts() const {
  std::map<std::string, SharedText> all;
  for (const auto& [id, gateway] : gateways_)
    all.emplace("gateway/" + id, gateway_text("gateway/" + id, gateway.life));
  for (const auto& [id, robot] : robots_)
    all.emplace("robot/" + id, robot_text("robot/" + id, robot.life));
  return all;
}

GatewayLife Roster::gateway(std::string_view id) const {
  const auto found = gateways_.find(id);
  return found == gateways_.end() ? GatewayLife{} : found->second.life;
}

RobotLife Roster::robot(std::string_view id) const {
  const auto found = robots_.find(id);
  return found == robots_.end() ? RobotLife{} : found->second.life;
}

std::int64_t Roster::last_heard_ms(std::string_view id) const {
  const auto found = robots_.find(id);
  if (found == robots_.end()) return 0;
  const auto& [gateway_of_newest, at_ms] = found->second.newest;
  const RobotLife& life = found->second.life;
  if (life.state == "offline") return life.heard_ms;
  return std::max(life.heard_ms, at_ms - gateway(gateway_of_newest).clock_ahead_ms);
}

}  // namespace slamgw::web
