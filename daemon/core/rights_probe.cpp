// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/rights_probe.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw {

RightsProbe::RightsProbe(const TopicScheme& scheme, const BrokerLink& broker,
                         GatewayActions& actions)
    : broker_(broker),
      actions_(actions),
      places_{{{fmt::format("{}/gateway/{}/{}", scheme.prefix(), scheme.gateway_id(), level),
                {"states, outcomes and numbers of this gateway do not reach the broker, or cannot "
                 "be read back",
                 fmt::format("topic readwrite {}/gateway/#", scheme.prefix())}},
               {fmt::format("{}/server/{}/{}", scheme.prefix(), scheme.gateway_id(), level),
                {"commands may not reach this gateway: its test message under server/ did not come "
                 "back",
                 fmt::format("topic read {0}/server/# (and, for this check, topic write "
                             "{0}/server/+/{1})",
                             scheme.prefix(), level)}}}} {}

RightsProbe::Place* RightsProbe::find(std::string_view topic) {
  const auto place = std::ranges::find(places_, topic, &Place::topic);
  return place == places_.end() ? nullptr : &*place;
}

void RightsProbe::on_broker_link() {
  for (Place& place : places_) {
    if (place.state == State::waiting) place.state = State::idle;
    if (broker_.is_up) actions_.push(SubscribeAtBroker{place.topic});
  }
}

bool RightsProbe::on_subscribe_result(const std::string& filter, bool is_granted, const Now& now) {
  Place* const place = find(filter);
  if (!place) return false;
  place->sent = now.mono;
  if (is_granted)
    ask(*place, now);
  else
    place->state = State::unheard;
  report_changes();
  return true;
}

/// The wall clock in the nonce tells this process's messages from those of a former process; the
/// number tells them from each other.
void RightsProbe::ask(Place& place, const Now& now) {
  const auto since_epoch = now.wall.time_since_epoch();
  place.nonce = fmt::format(
      "{}-{}", std::chrono::duration_cast<std::chrono::microseconds>(since_epoch).count(),
      ++asked_);
  if (place.state != State::unheard) place.state = State::waiting;
  actions_.push(Upload{{place.topic, to_bytes(place.nonce), Qos::at_most_once, false}, no_receipt});
}

bool RightsProbe::take(const BrokerMessage& message) {
  Place* const place = find(message.topic);
  if (!place) return false;
  if (place->nonce.empty() || as_text(message.payload) != place->nonce) return true;
  place->state = State::heard;
  place->nonce.clear();
  report_changes();
  return true;
}

bool RightsProbe::is_of_any_gateway(std::string_view type, const BrokerMessage& message) {
  if (type != level || message.qos != Qos::at_most_once || message.retain) return false;
  const std::string_view nonce = as_text(message.payload);
  const std::size_t dash = nonce.find('-');
  const auto is_number = [](std::string_view text) {
    return !text.empty() && text.find_first_not_of("0123456789") == text.npos;
  };
  return dash != nonce.npos && is_number(nonce.substr(0, dash)) &&
         is_number(nonce.substr(dash + 1));
}

/// Probes again from the subscription on, because a broker may have refused it.
void RightsProbe::on_deadline(const Now& now) {
  if (!broker_.is_up) return;
  for (Place& place : places_) {
    if (place.state == State::waiting && now.mono - place.sent >= patience)
      place.state = State::unheard;
    if (place.state != State::unheard || now.mono - place.sent < retry) continue;
    place.sent = now.mono;
    actions_.push(SubscribeAtBroker{place.topic});
  }
  report_changes();
}

std::optional<TimePoint> RightsProbe::deadline() const {
  std::optional<TimePoint> next;
  if (!broker_.is_up) return next;
  for (const Place& place : places_) {
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

void RightsProbe::report_changes() {
  std::vector<MissingRight> now_missing = missing();
  if (now_missing == reported_) return;
  reported_ = std::move(now_missing);
  if (reported_.empty())
    return actions_.push(
        Notice{Severity::notice,
               "the broker's access control list gives all rights that this gateway needs",
               {},
               Occasion::broker_link});
  std::string text = "the broker's access control list lacks rights for this gateway's user";
  for (const MissingRight& right : reported_)
    text += fmt::format("; {}: {}", right.what, right.grant);
  actions_.push(Notice{Severity::warning, std::move(text), {}, Occasion::broker_link});
}

}  // namespace slamgw
