// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/join_requests.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw {

using nlohmann::json;

namespace {

std::string dumped(const json& document) {
  return document.dump(-1, ' ', false, json::error_handler_t::replace);
}

}  // namespace

Result<PermitJoinOrder, std::string> parse_join_request(ByteView payload) {
  constexpr std::uint64_t most = std::chrono::seconds(PermitJoinOrder::longest).count();
  const std::string shape = fmt::format(
      R"(a request must be {{"seconds": N}} (a whole number, 0 to {}), with "name" to admit one )"
      "robot only; no other keys",
      most);
  if (payload.size() > JoinRequests::max_payload) return shape;
  const json request = json::parse(payload.begin(), payload.end(), nullptr, false);
  const auto seconds = request.is_object() ? request.find("seconds") : request.end();
  if (seconds == request.end() || !seconds->is_number_unsigned()) return shape;
  const auto count = seconds->get<std::uint64_t>();
  if (count > most) return shape;
  PermitJoinOrder order{std::chrono::seconds(count), {}};
  const auto name = request.find("name");
  const std::size_t members = name == request.end() ? 1 : 2;
  if (request.size() != members) return shape;  // a misspelt "name" must not let all robots in
  if (name == request.end()) return order;
  if (!name->is_string() || !is_valid_level(name->get_ref<const std::string&>())) return shape;
  order.robot = *name;
  return order;
}

void JoinRequests::on_request(const BrokerMessage& message, const Now& now) {
  if (message.retain)
    return refuse(
        "the request is retained, so it may be old: clear it, then publish without retain", true,
        now);
  if (requested_at_ && now.mono - *requested_at_ < shortest_pause)
    return refuse("only one request per second is allowed", false, now);
  requested_at_ = now.mono;
  auto order = parse_join_request(message.payload);
  if (!order.has_value()) return refuse(order.error(), true, now);
  ++ordered_;
  actions_.push(OrderJoining{who_of(message.sender), std::move(*order)});
}

/// Writes one log line for a burst. `is_answered`: every request is answered, not only the first
/// one of a burst.
void JoinRequests::refuse(const std::string& why, bool is_answered, const Now& now) {
  ++refused_;
  const auto count = refusals_.on_event(now.mono);
  if (count)
    actions_.push(Notice{
        Severity::warning,
        fmt::format(
            "a request to let robots join was refused: {}{}", why,
            *count > 1 ? fmt::format(" ({} such requests since the last line)", *count) : ""),
        {}});
  if (count || is_answered) actions_.push(PublishJoining{dumped({{"error", why}})});
}

/// Publishes no document itself but asks for the news, so that each document has all events since
/// the permit.
void JoinRequests::on_ordered(const OrderAnswer& answer, const Now& now) {
  if (!answer.error.empty())
    return actions_.push(PublishJoining{dumped({{"error", answer.error}})});
  const json permit = json::parse(answer.json, nullptr, false);
  if (!permit.is_object()) return;
  if (permit.value("seconds_left", 0) > 0) before_ = permit.value("last", std::uint64_t{0});
  due_ = now.mono;
  on_deadline(now);
}

void JoinRequests::on_deadline(const Now& now) {
  ask_at_ = now.mono + interval;
  actions_.push(AskJoining{{before_}});
}

void JoinRequests::on_news(const OrderAnswer& answer, const Now& now) {
  json news = json::parse(answer.json, nullptr, false);
  if (!news.is_object()) return ask_at_.reset();
  const bool is_over = news.value("seconds_left", 0) == 0 && news.value("under_way", 0) == 0;
  const auto last = news.value("last", std::uint64_t{0});
  if (is_over) ask_at_.reset();
  if (!is_over && last == last_published_ && now.mono < due_) return;
  last_published_ = last;
  due_ = now.mono + repeat;
  json& events = news["events"];
  if (events.size() > max_events)
    events.erase(events.begin(), events.end() - static_cast<std::ptrdiff_t>(max_events));
  actions_.push(PublishJoining{dumped(news)});
}

void JoinRequests::add_to(Counters& counters) const {
  counters.push_back({"join_requests", ordered_});
  counters.push_back({"join_requests_refused", refused_});
}

}  // namespace slamgw
