// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/rights_probe.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/core/protocol_machine.hpp"

namespace slamgw {

RightsProbe::RightsProbe(const TopicScheme& scheme)
    : places_{{{fmt::format("{}/gateway/{}/{}", scheme.prefix(), scheme.gateway_id(), level),
                {"states, outcomes and numbers of this gateway do not reach the broker, or cannot "
                 "be read back",
                 fmt::format("topic readwrite {}/gateway/#", scheme.prefix())}},
               {fmt::format("{}/server/{}/{}", scheme.prefix(), scheme.gateway_id(), level),
                {"commands may not reach this gateway: its test message under server/ did not come "
                 "back",
                 fmt::format("topic read {0}/server/# (and, for this check, topic write "
                             "{0}/server/+/{1})",
                             scheme.prefix(), level)}}}} {}

std::vector<std::string> RightsProbe::filters() const {
  std::vector<std::string> filters;
  for (const Place& place : places_) filters.push_back(place.topic);
  return filters;
}

bool RightsProbe::is_own(const std::string& filter) const {
  return std::ranges::any_of(places_, [&](const Place& place) { return place.topic == filter; });
}

void RightsProbe::on_broker_link(bool is_probing) {
  is_probing_ = is_probing;
  for (Place& place : places_)
    if (place.state == State::waiting) place.state = State::idle;
}

std::optional<BrokerMessage> RightsProbe::on_subscribe_result(const std::string& filter,
                                                              bool granted, const Now& now) {
  const auto place = std::find_if(places_.begin(), places_.end(),
                                  [&](const Place& p) { return p.topic == filter; });
  if (place == places_.end()) return std::nullopt;
  if (granted) return ask(*place, now);
  place->state = State::unheard;
  place->sent = now.mono;
  return std::nullopt;
}

/// The wall clock in the nonce tells this process's messages from those of a former process; the
/// number tells them from each other.
BrokerMessage RightsProbe::ask(Place& place, const Now& now) {
  const auto since_epoch = now.wall.time_since_epoch();
  place.nonce = fmt::format(
      "{}-{}", std::chrono::duration_cast<std::chrono::microseconds>(since_epoch).count(),
      ++asked_);
  place.state = place.state == State::unheard ? State::unheard : State::waiting;
  place.sent = now.mono;
  return {place.topic, to_bytes(place.nonce), Qos::at_most_once, false};
}

bool RightsProbe::take(const BrokerMessage& message) {
  const auto place = std::find_if(places_.begin(), places_.end(),
                                  [&](const Place& p) { return p.topic == message.topic; });
  if (place == places_.end()) return false;
  if (place->nonce.empty() || as_text(message.payload) != place->nonce) return true;
  place->state = State::heard;
  place->nonce.clear();
  return true;
}

std::vector<BrokerMessage> RightsProbe::on_tick(const Now& now) {
  std::vector<BrokerMessage> messages;
  if (!is_probing_) return messages;
  for (Place& place : places_) {
    if (place.state == State::waiting && now.mono - place.sent >= patience)
      place.state = State::unheard;
    if (place.state == State::unheard && now.mono - place.sent >= retry)
      messages.push_back(ask(place, now));
  }
  return messages;
}

std::optional<TimePoint> RightsProbe::deadline() const {
  std::optional<TimePoint> next;
  for (const Place& place : places_) {
    if (!is_probing_) break;
    if (place.state == State::waiting) next = earlier(next, place.sent + patience);
    if (place.state == State::unheard) next = earlier(next, place.sent + retry);
  }
  return next;
}

std::vector<MissingRight> RightsProbe::missing() const {
  std::vector<MissingRight> missing;
  for (const Place& place : places_)
    if (place.state == State::unheard) missing.push_back(place.right);
  return missing;
}

std::optional<Notice> RightsProbe::next_notice() {
  std::vector<MissingRight> now_missing = missing();
  if (now_missing == reported_) return std::nullopt;
  reported_ = std::move(now_missing);
  if (reported_.empty())
    return Notice{Severity::notice,
                  "the broker's access control list gives all rights that this gateway needs",
                  {},
                  Occasion::broker_link};
  std::string text = "the broker's access control list lacks rights for this gateway's user";
  for (const MissingRight& right : reported_)
    text += fmt::format("; {}: {}", right.what, right.grant);
  return Notice{Severity::warning, std::move(text), {}, Occasion::broker_link};
}

}  // namespace slamgw
