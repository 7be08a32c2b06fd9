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
  const Result<Wish, ReturnCode> wish = read(session, request, now);
  if (!wish) return refuse(session, request, wish.error());
  const std::string& filter = wish->filter;
  if (!requests_.has_room(filter)) return;
  const Suback answer{request.qos, wish->topic_id, request.msg_id, ReturnCode::accepted};
  if (is_repetition(session, request, filter, now)) return answers_.answer(session, answer);

  if (!session.subscribe_rate.take(limits::subscribe_burst, limits::subscribe_interval, now)) {
    output_.count(Count::subscribes_bounded);
    return refuse(session, request, ReturnCode::congestion);
  }
  const bool is_new = !session.subscriptions.contains(filter);
  Subscription& subscription = session.subscriptions[filter];
  const auto qos = static_cast<Qos>(request.qos);
  subscription = {qos,          request.topic_id_type, wish->topic_id, request.msg_id,
                  std::nullopt, RetainedWait{}};
  if (is_new) add_subscriber(filter, session, subscription);
  if (request.topic_id_type == TopicIdType::normal) session.topics.set_known(wish->topic_id, true);
  output_.mark_changed(session);
  ask_broker(session, filter, qos, answer, now);
}

void Subscriptions::on_unsubscribe(ClientSession& session, const Unsubscribe& request,
                                   TimePoint now) {
  if (!answers_.has_room(session)) return;
  std::string storage;
  const std::string* filter =
      name(session, request.topic_id_type, request.topic_id, request.topic_name, storage);
  answers_.answer(session, Unsuback{request.msg_id});
  if (filter) drop(session, std::string(*filter), now);
}

std::vector<ClientSession*> Subscriptions::on_subscribe_result(const std::string& filter,
                                                               bool granted, TimePoint now) {
  std::vector<ClientSession*> answered;
  for (SubscribeRequests::Waiting& waiting : requests_.on_result(filter, now)) {
    const auto session = waiting.session.lock();
    if (!session) continue;
    const auto subscription = session->subscriptions.find(filter);
    if (granted && subscription != session->subscriptions.end()) {
      subscription->second.granted_at = now;
      std::optional<RetainedWait>& wait = subscription->second.retained_wait;
      if (wait && broker_up_since_) wait->until = now + limits::retained_wait;
    } else if (!granted) {
      waiting.answer = {WireQos::zero, 0, waiting.answer.msg_id, ReturnCode::not_supported};
    }
    answers_.release(*session, waiting.ticket, waiting.answer);
    answered.push_back(session.get());
  }
  if (!granted) drop_everywhere(filter, now);
  note_listening(filter, granted);
  return answered;
}

void Subscriptions::on_broker_up(TimePoint now) {
  for (const std::string& filter : std::exchange(refused_listening_, {}))
    requests_.ask(filter, Qos::at_least_once, {}, now, false);
  for (const auto& [id, session] : clients_.all()) {
    bool has_begun = false;
    for (auto& [name, subscription] : session->subscriptions) has_begun |= begin_wait(subscription);
    if (has_begun) output_.mark_changed(*session);
  }
}

/// What waits for retained messages waits for those of the next connection: these may never come.
void Subscriptions::on_broker_down(TimePoint now) {
  for (const auto& [id, session] : clients_.all()) {
    for (auto& [name, subscription] : session->subscriptions) {
      std::optional<RetainedWait>& wait = subscription.retained_wait;
      if (!wait || !wait->until || *wait->until < now) continue;
      wait->until.reset();
      output_.mark_changed(*session);
    }
  }
}

/// What was subscribed while the broker was away gets its retained messages once it is back. False
/// when it does not begin to wait for them now.
bool Subscriptions::begin_wait(Subscription& subscription) const {
  std::optional<RetainedWait>& wait = subscription.retained_wait;
  if (!wait || wait->until || !subscription.granted_at || !broker_up_since_) return false;
  wait->until = std::max(*subscription.granted_at, *broker_up_since_) + limits::retained_wait;
  return true;
}

bool Subscriptions::takes_retained(Subscription& subscription, const std::string& topic,
                                   TimePoint now) const {
  std::optional<RetainedWait>& wait = subscription.retained_wait;
  if (!wait) return false;
  begin_wait(subscription);
  if (wait->until && *wait->until < now) {
    wait.reset();
    return false;
  }
  if (wait->seen.size() >= limits::max_retained_per_wait) return false;
  return wait->seen.insert(topic).second;
}

std::vector<Subscriptions::Match> Subscriptions::match(const std::string& topic) const {
  std::vector<Match> found;
  subscribers_.match(topic, [&](const std::vector<Match>& subscribers) {
    found.insert(found.end(), subscribers.begin(), subscribers.end());
  });
  return found;
}

bool Subscriptions::is_wanted(const ClientSession& session, const std::string& topic) const {
  return std::any_of(session.subscriptions.begin(), session.subscriptions.end(),
                     [&](const auto& entry) { return filter_matches(entry.first, topic); });
}

void Subscriptions::drop(ClientSession& session, const std::string& filter, TimePoint now) {
  if (!session.subscriptions.contains(filter)) return;
  remove_subscriber(filter, session);
  session.subscriptions.erase(filter);
  output_.mark_changed(session);
  unsubscribe_unwanted(filter, now);
}

/// The broker has refused it, perhaps after it was granted while the broker was away. Those who
/// still wait get an answer of their own.
void Subscriptions::drop_everywhere(const std::string& filter, TimePoint now) {
  const std::vector<Match>* const subscribers = subscribers_.find(filter);
  if (!subscribers) return;
  const auto waiting = requests_.sessions_waiting_for(filter);
  for (const Match& match : std::vector<Match>(*subscribers))
    if (!waiting.contains(match.session)) drop(*match.session, filter, now);
}

void Subscriptions::add_subscriber(const std::string& filter, ClientSession& session,
                                   Subscription& subscription) {
  subscribers_[filter].push_back({&session, &subscription});
  session.filter_octets += NameBudget::of_filter(filter);
  clients_.names().take(NameBudget::of_filter(filter));
}

void Subscriptions::remove_subscriber(const std::string& filter, ClientSession& session) {
  session.filter_octets -= NameBudget::of_filter(filter);
  clients_.names().give_back(NameBudget::of_filter(filter));
  std::vector<Match>& subscribers = subscribers_[filter];
  std::erase_if(subscribers, [&](const Match& match) { return match.session == &session; });
  if (subscribers.empty()) subscribers_.erase(filter);
}

void Subscriptions::unsubscribe_unwanted(const std::string& filter, TimePoint now) {
  if (subscribers_.find(filter) || listening_.contains(filter)) return;
  output_.emit(UnsubscribeRequest{Mesh::thread, filter});
  // No answer is owed to us any more.
  for (const SubscribeRequests::Waiting& waiting : requests_.forget(filter, now)) {
    if (const auto session = waiting.session.lock())
      answers_.release(*session, waiting.ticket, waiting.answer);
  }
}

void Subscriptions::drop_all(ClientSession& session, TimePoint now) {
  while (!session.subscriptions.empty())
    drop(session, std::string(session.subscriptions.begin()->first), now);
}

void Subscriptions::drop_forbidden(ClientSession& session, TimePoint now) {
  std::vector<std::string> forbidden;
  for (const auto& [filter, subscription] : session.subscriptions) {
    if (!rules_.policy.may_subscribe(session.client_id, session.robot, filter))
      forbidden.push_back(filter);
  }
  for (const std::string& filter : forbidden) drop(session, filter, now);
}

void Subscriptions::restore(ClientSession& session, TimePoint now) {
  std::vector<std::string> forbidden;
  std::vector<std::string> too_large;
  for (auto each = session.subscriptions.begin(); each != session.subscriptions.end();) {
    auto& [filter, subscription] = *each;
    const bool is_allowed = is_valid_filter(filter) &&
                            rules_.policy.may_subscribe(session.client_id, session.robot, filter);
    const bool has_room =
        clients_.names().may_restore(clients_.size(), NameBudget::of_filter(filter));
    if (is_allowed && has_room) {
      add_subscriber(filter, session, subscription);
      requests_.ask(filter, subscription.qos, {}, now, subscription.retained_wait.has_value());
      ++each;
      continue;
    }
    (is_allowed ? too_large : forbidden).push_back(filter);
    each = session.subscriptions.erase(each);
  }
  notice_given_up(session, std::move(forbidden), "topics.extra_subscribe no longer allows them",
                  now);
  notice_given_up(session, std::move(too_large),
                  "all clients' filters together are larger than the bound", now);
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

/// Those of the session's filters that name this robot.
std::vector<std::string> Subscriptions::filters_of(const ClientSession& session,
                                                   const std::string& robot) const {
  std::vector<std::string> filters;
  for (const auto& [filter, subscription] : session.subscriptions) {
    if (replace_robot(rules_.policy.scheme(), filter, robot, robot)) filters.push_back(filter);
  }
  return filters;
}

void Subscriptions::suspend(ClientSession& session, const std::string& robot, TimePoint now) {
  for (const std::string& filter : filters_of(session, robot)) {
    remove_subscriber(filter, session);
    unsubscribe_unwanted(filter, now);
  }
}

void Subscriptions::resume(ClientSession& session, TimePoint now) {
  for (const std::string& filter : filters_of(session, session.robot)) {
    Subscription& subscription = session.subscriptions.at(filter);
    subscription.granted_at = now;
    subscription.retained_wait.emplace();
    add_subscriber(filter, session, subscription);
    requests_.ask(filter, subscription.qos, {}, now);
  }
}

void Subscriptions::listen_for_commands(const ClientSession& session, TimePoint now) {
  const std::string filter = rules_.policy.scheme().command_filter(session.robot);
  if (!listening_.insert(filter).second) return;
  requests_.ask(filter, Qos::at_least_once, {}, now, false);
}

void Subscriptions::stop_listening(const ClientSession& session, TimePoint now) {
  const std::string filter = rules_.policy.scheme().command_filter(session.robot);
  refused_listening_.erase(filter);
  if (listening_.erase(filter) > 0) unsubscribe_unwanted(filter, now);
}

void Subscriptions::note_listening(const std::string& filter, bool granted) {
  if (granted) {
    refused_listening_.erase(filter);
  } else if (listening_.contains(filter)) {
    refused_listening_.insert(filter);
  }
}

Result<Subscriptions::Wish, ReturnCode> Subscriptions::read(ClientSession& session,
                                                            const Subscribe& request,
                                                            TimePoint now) {
  if (request.qos == WireQos::minus_one || request.topic_id_type == TopicIdType::reserved)
    return ReturnCode::not_supported;
  std::string storage;
  const std::string* filter =
      name(session, request.topic_id_type, request.topic_id, request.topic_name, storage);
  if (!filter) return ReturnCode::invalid_topic_id;
  const auto slashes = std::count(filter->begin(), filter->end(), '/');
  const bool is_sane =
      is_valid_filter(*filter) && static_cast<std::size_t>(slashes) < limits::max_filter_levels;
  if (!is_sane) return ReturnCode::not_supported;
  if (!rules_.policy.may_subscribe(session.client_id, session.robot, *filter)) {
    notice_refusal(session, *filter, now);
    return ReturnCode::not_supported;
  }
  const bool is_new = !session.subscriptions.contains(*filter);
  if (is_new && session.subscriptions.size() >= limits::max_subscriptions_per_client)
    return ReturnCode::congestion;
  const std::size_t octets = NameBudget::of_filter(*filter);
  if (is_new && !clients_.names().may_take(session.filter_octets, octets))
    return ReturnCode::congestion;
  if (request.topic_id_type == TopicIdType::predefined) return Wish{*filter, request.topic_id};
  if (request.topic_id_type == TopicIdType::short_name || has_wildcard(*filter))
    return Wish{*filter, 0};  // R95, R96
  const auto id = session.assign_topic(*filter);
  if (!id) return ReturnCode::congestion;
  session.topics.set_own(*id);
  return Wish{*filter, *id};
}

const std::string* Subscriptions::name(ClientSession& session, TopicIdType type,
                                       std::uint16_t topic_id, const std::string& topic_name,
                                       std::string& storage) const {
  switch (type) {
    case TopicIdType::normal: storage = topic_name; break;
    case TopicIdType::predefined: {
      const std::string* known = rules_.predefined.name_of(session.client_id, topic_id);
      if (!known) return nullptr;
      storage = *known;
      break;
    }
    case TopicIdType::short_name: storage = short_name(topic_id); return &storage;
    case TopicIdType::reserved: return nullptr;
  }
  storage = to_broker_name(rules_.policy.scheme(), session, std::move(storage));
  return &storage;
}

void Subscriptions::refuse(ClientSession& session, const Subscribe& request, ReturnCode code) {
  const Suback suback{WireQos::zero, 0, request.msg_id, code};
  if (code == ReturnCode::congestion) return answers_.refuse_for_room(session, suback);
  answers_.answer(session, suback);
}

/// A SUBSCRIBE whose SUBACK was lost (R99): nothing new, so no retained messages again.
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

void Subscriptions::ask_broker(ClientSession& session, const std::string& filter, Qos qos,
                               Suback answer, TimePoint now) {
  const std::uint64_t ticket = answers_.hold(session, answer.msg_id);
  requests_.ask(filter, qos, {clients_.weak(session), ticket, answer}, now);
}

void Subscriptions::notice_refusal(const ClientSession& session, const std::string& filter,
                                   TimePoint now) {
  refusals_.on_refusal(Count::topics_refused, "subscribe " + session.client_id,
                       fmt::format("{} may not subscribe to '{}': a matching filter in "
                                   "topics.extra_subscribe would allow it",
                                   session.robot, filter),
                       session.robot, now);
}

}  // namespace slamgw::mqttsn
