// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/subscribe_requests.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

/// Paces end at whole multiples of this, so those of many filters at once: each time wakes the
/// loop.
using ForgetInterval = std::chrono::duration<Duration::rep, std::ratio<10>>;

TimePoint forget_at(TimePoint full) {
  return TimePoint(std::chrono::ceil<ForgetInterval>(full.time_since_epoch()));
}

}  // namespace

bool SubscribeRequests::has_room(const std::string& filter) const {
  const auto known = requests_.find(filter);
  return known == requests_.end() ||
         known->second.open.size() + known->second.joined.size() < limits::max_open_per_filter;
}

void SubscribeRequests::ask(const std::string& filter, Qos qos, Waiting waiting, TimePoint now,
                            bool wants_retained) {
  Request& request = requests_[filter];
  request.joined.push_back(std::move(waiting));
  request.qos = std::max(request.qos, qos);
  request.wants_retained = request.wants_retained || wants_retained;
  advance(filter, request, now);
}

std::vector<SubscribeRequests::Waiting> SubscribeRequests::on_result(const std::string& filter,
                                                                     TimePoint now) {
  const auto known = requests_.find(filter);
  if (known == requests_.end()) return {};
  std::vector<Waiting> answered = std::exchange(known->second.open, {});
  advance(filter, known->second, now);
  return answered;
}

std::vector<SubscribeRequests::Waiting> SubscribeRequests::forget(const std::string& filter,
                                                                  TimePoint now) {
  const auto known = requests_.find(filter);
  if (known == requests_.end()) return {};
  std::vector<Waiting> left = std::exchange(known->second.open, {});
  std::ranges::move(known->second.joined, std::back_inserter(left));
  known->second.joined = {};
  schedule(filter, known->second, now);
  return left;
}

std::unordered_set<const ClientSession*> SubscribeRequests::sessions_waiting_for(
    const std::string& filter) const {
  std::unordered_set<const ClientSession*> sessions;
  const auto known = requests_.find(filter);
  if (known == requests_.end()) return sessions;
  for (const auto* all : {&known->second.open, &known->second.joined})
    for (const Waiting& waiting : *all) sessions.insert(waiting.session.lock().get());
  return sessions;
}

void SubscribeRequests::on_deadline(TimePoint now) {
  while (const auto filter = timers_.pop_due(now)) {
    Request& request = requests_.at(*filter);
    request.armed.reset();
    advance(*filter, request, now);
  }
}

/// Without a broker nothing is sent: the core answers at once, and asks for all when it is back.
void SubscribeRequests::advance(const std::string& filter, Request& request, TimePoint now) {
  const bool is_due = request.open.empty() && !request.joined.empty();
  if (is_due && (!broker_up_since_ || request.pace.take(limits::broker_subscribe_burst,
                                                        limits::broker_subscribe_interval, now))) {
    request.open = std::exchange(request.joined, {});
    const Qos qos = std::exchange(request.qos, Qos::at_most_once);
    const bool wants_retained = std::exchange(request.wants_retained, false);
    output_.emit(SubscribeRequest{Mesh::thread, filter, qos, wants_retained});
  }
  schedule(filter, request, now);
}

void SubscribeRequests::schedule(const std::string& filter, Request& request, TimePoint now) {
  timers_.disarm(request.armed, filter);
  if (!request.open.empty()) return;
  if (!request.joined.empty()) {
    const TimePoint ready =
        request.pace.ready_at(limits::broker_subscribe_burst, limits::broker_subscribe_interval);
    return timers_.arm_by(request.armed, filter, std::max(ready, now));
  }
  const bool is_idle = request.pace.is_full(now);
  if (is_idle || requests_.size() > limits::max_paced_filters) {
    requests_.erase(requests_.find(filter));
    return;
  }
  timers_.arm_by(request.armed, filter, forget_at(request.pace.full_at()));
}

}  // namespace slamgw::mqttsn
