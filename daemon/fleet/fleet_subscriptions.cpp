// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/fleet_subscriptions.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace slamgw::fleet {
namespace {

/// The commands first: a gateway that hears the others and not the commands would miss those that
/// they leave to it.
std::array<std::string, 4> filters_of_others(const FleetTopics& topics) {
  return {topics.command_filter(), topics.all_filter(), topics.own_filter(),
          topics.outcome_filter()};
}

}  // namespace

void FleetSubscriptions::on_link_up(bool is_session_kept, TimePoint now) {
  is_session_kept_ = is_session_kept;
  asked_ = now;
  for (auto& [filter, answer] : answers_)
    if (answer == Answer::granted) answer = Answer::missing;
}

void FleetSubscriptions::on_answer(const std::string& filter, SubscribeAnswer answer) {
  const auto asked = answers_.find(filter);
  if (asked == answers_.end()) return;
  switch (answer) {
    case SubscribeAnswer::granted: asked->second = Answer::granted; return;
    case SubscribeAnswer::refused: answers_.erase(asked); return;  // the next connection asks again
    case SubscribeAnswer::closes_connection: asked->second = Answer::closes_connection; return;
  }
}

void FleetSubscriptions::subscribe(const std::string& filter, TimePoint now) {
  if (!answers_.try_emplace(filter, Answer::missing).second) return;
  asked_ = now;
  membership_.actions.push(SubscribeFleet{filter});
}

void FleetSubscriptions::subscribe_to_others(bool was_alone, TimePoint now) {
  if (was_alone) answers_.erase(membership_.topics.command_filter());
  for (const std::string& filter : filters_of_others(membership_.topics)) subscribe(filter, now);
}

void FleetSubscriptions::unsubscribe_from_others(bool keeps_beats) {
  for (const std::string& filter : filters_of_others(membership_.topics)) {
    if (keeps_beats && filter == membership_.topics.all_filter()) continue;
    if (answers_.erase(filter) > 0) membership_.actions.push(UnsubscribeFleet{filter});
  }
}

void FleetSubscriptions::unsubscribe_stale() {
  if (!std::exchange(is_session_kept_, false)) return;
  const auto end = [this](const std::string& filter) {
    if (!answers_.contains(filter)) membership_.actions.push(UnsubscribeFleet{filter});
  };
  std::ranges::for_each(filters_of_others(membership_.topics), end);
  end(membership_.topics.state_filter());
}

bool FleetSubscriptions::are_answered(TimePoint now) const {
  return now - asked_ >= answer_patience || std::ranges::none_of(answers_, [&](const auto& each) {
           return each.second == Answer::missing && each.first != membership_.topics.state_filter();
         });
}

}  // namespace slamgw::fleet
