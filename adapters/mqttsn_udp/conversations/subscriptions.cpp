// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/conversations/own_names.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
void Subscriptions::on_subscribe(ClientSession& session, const Subscribe& request, TimePoint now) {
  if (answers_.is_held(session, request.msg_id) || !answers_.has_room(session)) return;
  const Result<Requested, ReturnCode> requested = read(session, request, now);
  if (!requested) {
    if (requested.error() == ReturnCode::congestion) {
      const auto filter =
          filter_of(session, request.topic_id_type, request.topic_id, request.topic_name);
      refusals_.on_full_tables(session, filter.value_or(""), now);
    }
    return refuse(session, request, requested.error());
  }
  const std::string& filter = requested->filter;
  const Suback answer{request.qos, requested->topic_id, request.msg_id, ReturnCode::accepted};
  if (is_repetition(session, request, filter, now)) return answers_.answer(session, answer);

  if (!session.subscribe_rate.take(limits::subscribe_burst, limits::subscribe_interval, now)) {
    output_.count(Count::subscribes_bounded);
    return refuse(session, request, ReturnCode::congestion);
  }
  if (!session.subscriptions.contains(filter)) charge(session, filter);
  const auto qos = static_cast<Qos>(request.qos);
  session.subscriptions[filter] = {
      qos, request.topic_id_type, requested->topic_id, request.msg_id, {}};
  TopicTable::Topic* const topic = session.topics.find(requested->topic_id);  // null for wildcards
  if (topic && request.topic_id_type == TopicIdType::normal) topic->is_known = true;
  output_.mark_changed(session);
  answers_.hold(session, filter, answer);
  ask(session, filter, qos, false);
}

std::optional<std::string> Subscriptions::on_unsubscribe(ClientSession& session,
                                                         const Unsubscribe& request,
                                                         TimePoint now) {
  if (!answers_.has_room(session)) return std::nullopt;
  const auto filter =
      filter_of(session, request.topic_id_type, request.topic_id, request.topic_name);
  const bool is_known = filter && session.subscriptions.contains(*filter);
  // Beyond the rate of SUBSCRIBE, unknown filters do not reach the broker.
  const bool may_be_kept =
      filter && !is_known && is_valid_filter(*filter) &&
      rules_.policy.may_subscribe(session.client_id, session.robot, *filter) &&
      session.subscribe_rate.take(limits::subscribe_burst, limits::subscribe_interval, now);
  answers_.answer(session, Unsuback{request.msg_id});
  if (session.dropped_before_note && (is_known || may_be_kept)) {
    session.dropped_before_note->insert(*filter);
    if (session.dropped_before_note->size() > limits::max_dropped_before_note)
      session.dropped_before_note.reset();  // the note is not read any more
  }
  if (is_known) drop(session, *filter);
  if (may_be_kept) output_.emit(UnsubscribeRequest{Mesh::thread, session.robot, *filter});
  return is_known || may_be_kept ? filter : std::nullopt;
}

/// The broker's refusal may come after the filter was granted while the broker was away.
void Subscriptions::on_subscribe_result(ClientSession& session, const std::string& filter,
                                        bool granted, TimePoint now) {
  answers_.release(session, filter, granted);
  const auto subscription = session.subscriptions.find(filter);
  if (subscription == session.subscriptions.end()) return;
  if (!granted) return drop(session, filter);
  subscription->second.granted_at = now;
}

const Subscription* Subscriptions::best_match(const ClientSession& session,
                                              const std::string& topic) {
  const auto rank = [](const Subscription& s) { return std::pair(s.qos, s.topic_id_type); };
  const Subscription* best = nullptr;
  for (const auto& [filter, subscription] : session.subscriptions) {
    const bool is_better = !best || rank(subscription) > rank(*best);
    if (is_better && filter_matches(filter, topic)) best = &subscription;
  }
  return best;
}

/// Releases waiting SUBACKs, too: the broker does not answer for this filter any more.
void Subscriptions::drop(ClientSession& session, const std::string& filter) {
  const auto node = session.subscriptions.extract(filter);
  if (node.empty()) return;
  discharge(session, node.key());
  output_.mark_changed(session);
  output_.emit(UnsubscribeRequest{Mesh::thread, session.robot, node.key()});
  answers_.release(session, node.key(), true);
}

void Subscriptions::drop_all(ClientSession& session) {
  while (!session.subscriptions.empty())
    drop(session, std::string(session.subscriptions.begin()->first));
}

void Subscriptions::drop_forbidden(ClientSession& session) {
  std::vector<std::string> forbidden;
  for (const auto& [filter, subscription] : session.subscriptions) {
    if (!rules_.policy.may_subscribe(session.client_id, session.robot, filter))
      forbidden.push_back(filter);
  }
  for (const std::string& filter : forbidden) drop(session, filter);
}

void Subscriptions::forget_all(ClientSession& session) {
  for (const auto& [filter, subscription] : session.subscriptions) discharge(session, filter);
  session.subscriptions.clear();
}

void Subscriptions::charge(ClientSession& session, const std::string& filter) {
  session.filter_octets += NameBudget::of_filter(filter.size());
  clients_.names().take(NameBudget::of_filter(filter.size()));
}

void Subscriptions::discharge(ClientSession& session, const std::string& filter) {
  session.filter_octets -= NameBudget::of_filter(filter.size());
  clients_.names().give_back(NameBudget::of_filter(filter.size()));
}

void Subscriptions::ask(const ClientSession& session, const std::string& filter, Qos qos,
                        bool is_standing) {
  output_.emit(SubscribeRequest{Mesh::thread, session.robot, filter, qos, is_standing});
}

void Subscriptions::restore(ClientSession& session, bool are_standing, TimePoint now) {
  std::vector<std::string> forbidden;
  std::vector<std::string> too_large;
  std::size_t restored = 0;
  for (auto each = session.subscriptions.begin(); each != session.subscriptions.end();) {
    const auto& [filter, subscription] = *each;
    const bool is_allowed = is_valid_filter(filter) &&
                            rules_.policy.may_subscribe(session.client_id, session.robot, filter);
    const bool has_room =
        restored < limits::max_subscriptions_per_client &&
        clients_.names().may_restore(clients_.size(), NameBudget::of_filter(filter.size()));
    if (is_allowed && has_room) {
      ++restored;
      charge(session, filter);
      ask(session, filter, subscription.qos, are_standing);
      ++each;
      continue;
    }
    output_.emit(UnsubscribeRequest{Mesh::thread, session.robot, filter});
    (is_allowed ? too_large : forbidden).push_back(filter);
    each = session.subscriptions.erase(each);
  }
  notice_given_up(session, std::move(forbidden), "topics.extra_subscribe no longer allows them",
                  now);
  notice_given_up(session, std::move(too_large),
                  "all clients' filters together are larger than the bound", now);
}

void Subscriptions::add_noted(ClientSession& session,
                              const std::vector<SubscriptionSnapshot>& noted,
                              const std::set<std::string>& dropped, TimePoint now) {
  for (const auto& [filter, subscription] : session.subscriptions) discharge(session, filter);
  for (const SubscriptionSnapshot& s : noted)
    if (!dropped.contains(s.filter))
      session.subscriptions.emplace(s.filter,
                                    Subscription{s.qos, s.topic_id_type, s.topic_id, 0, {}});
  restore(session, /*are_standing=*/true, now);
}

void Subscriptions::notice_given_up(const ClientSession& session, std::vector<std::string> filters,
                                    std::string_view why, TimePoint now) {
  constexpr std::size_t most_named = 5;
  if (filters.empty()) return;
  std::ranges::sort(filters);
  const std::size_t more = filters.size() - std::min(filters.size(), most_named);
  filters.resize(filters.size() - more);
  refusals_.on_refusal(Count::topics_refused, fmt::format("restore {} {}", session.client_id, why),
                       fmt::format("{}'s kept subscriptions to '{}'{} are given up: {}",
                                   session.robot, fmt::join(filters, "', '"),
                                   more > 0 ? fmt::format(" and {} more", more) : "", why),
                       session.robot, now);
}

Result<Subscriptions::Requested, ReturnCode> Subscriptions::read(ClientSession& session,
                                                                 const Subscribe& request,
                                                                 TimePoint now) {
  if (request.qos == WireQos::minus_one || request.topic_id_type == TopicIdType::reserved)
    return ReturnCode::not_supported;
  const auto filter =
      filter_of(session, request.topic_id_type, request.topic_id, request.topic_name);
  if (!filter) return ReturnCode::invalid_topic_id;
  if (!is_valid_filter(*filter)) return ReturnCode::not_supported;
  // Section 6.10: a message for a wildcard has an id that was registered.
  if (request.topic_id_type == TopicIdType::short_name && has_wildcard(*filter))
    return ReturnCode::not_supported;
  if (!rules_.policy.may_subscribe(session.client_id, session.robot, *filter)) {
    notice_refusal(session, *filter, now);
    return ReturnCode::not_supported;
  }
  const bool is_new = !session.subscriptions.contains(*filter);
  if (is_new && session.subscriptions.size() >= limits::max_subscriptions_per_client)
    return ReturnCode::congestion;
  const std::size_t octets = NameBudget::of_filter(filter->size());
  if (is_new && !clients_.names().may_take(session.filter_octets, octets))
    return ReturnCode::congestion;
  if (request.topic_id_type == TopicIdType::predefined) return Requested{*filter, request.topic_id};
  if (request.topic_id_type == TopicIdType::short_name || has_wildcard(*filter))
    return Requested{*filter, 0};  // R95, R96
  const auto id = session.assign_topic(*filter);
  if (!id) return ReturnCode::congestion;
  session.topics.find(*id)->is_own = true;
  return Requested{*filter, *id};
}

std::optional<std::string> Subscriptions::filter_of(ClientSession& session, TopicIdType type,
                                                    std::uint16_t topic_id,
                                                    const std::string& topic_name) const {
  auto name = type == TopicIdType::normal ? std::optional(topic_name)
                                          : rules_.topic_of(session.client_id, type, topic_id);
  if (name) name = to_broker_name(rules_.policy.scheme(), session, std::move(*name));
  return name;
}

void Subscriptions::refuse(ClientSession& session, const Subscribe& request, ReturnCode code) {
  const Suback suback{WireQos::zero, 0, request.msg_id, code};
  if (code == ReturnCode::congestion) return answers_.refuse_for_room(session, suback);
  answers_.answer(session, suback);
}

/// Returns true if the SUBACK of this SUBSCRIBE was lost (R99): it is not a new request, so
/// retained messages are not sent again.
bool Subscriptions::is_repetition(const ClientSession& session, const Subscribe& request,
                                  const std::string& filter, TimePoint now) const {
  const auto known = session.subscriptions.find(filter);
  if (known == session.subscriptions.end()) return false;
  const Subscription& subscription = known->second;
  return subscription.msg_id == request.msg_id && subscription.granted_at &&
         subscription.topic_id_type == request.topic_id_type &&
         subscription.qos == static_cast<Qos>(request.qos) &&
         now - *subscription.granted_at <= limits::repeat_window;
}

void Subscriptions::notice_refusal(const ClientSession& session, const std::string& filter,
                                   TimePoint now) {
  refusals_.on_refusal(Count::topics_refused, "subscribe " + session.client_id,
                       fmt::format("{} may not subscribe to '{}': a matching filter in "
                                   "topics.extra_subscribe would allow it",
                                   session.robot, filter),
                       session.robot, now);
}

// --- Answers -------------------------------------------------------------------------------------

bool Answers::has_room(const ClientSession& session) const {
  return session.answers.size() < limits::max_pending_answers;
}

void Answers::answer(ClientSession& session, Packet packet) {
  if (session.answers.empty()) return output_.send(session, std::move(packet));
  session.answers.push_back({std::move(packet), 0, {}});
}

void Answers::refuse_for_room(ClientSession& session, Packet congestion) {
  if (!settings_.is_full_silent()) answer(session, std::move(congestion));
}

void Answers::hold(ClientSession& session, const std::string& filter, const Suback& suback) {
  session.answers.push_back({suback, suback.msg_id, filter});
}

bool Answers::is_held(const ClientSession& session, std::uint16_t msg_id) const {
  return std::ranges::any_of(session.answers, [&](const PendingAnswer& answer) {
    return !answer.filter.empty() && answer.msg_id == msg_id;
  });
}

void Answers::release(ClientSession& session, const std::string& filter, bool granted) {
  for (PendingAnswer& answer : session.answers) {
    if (answer.filter != filter) continue;
    answer.filter.clear();
    if (!granted)
      answer.packet = Suback{WireQos::zero, 0, answer.msg_id, ReturnCode::not_supported};
  }
  while (!session.answers.empty() && session.answers.front().filter.empty()) {
    output_.send(session, std::move(session.answers.front().packet));
    session.answers.erase(session.answers.begin());
  }
  if (session.answers.empty()) session.answers.shrink_to_fit();
}

}  // namespace slamgw::mqttsn
