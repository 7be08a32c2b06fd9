// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/filter_suspects.hpp"

#include <algorithm>
#include <utility>

namespace slamgw {

void FilterSuspects::on_sent(const WantedSubscription& subscription) {
  Record& record = records_[subscription.filter];
  record.qos = subscription.qos;
  record.id = subscription.id;
  record.is_under_way = true;
}

void FilterSuspects::on_answered(const std::string& filter) {
  if (on_trial_ == filter) on_trial_.reset();
  const auto known = records_.find(filter);
  if (known == records_.end()) return;
  Record& record = known->second;
  record = {record.qos, record.id, false, true, 0, 0};
}

void FilterSuspects::forget(const std::string& filter) { records_.erase(filter); }

std::optional<std::string> FilterSuspects::on_lost(TimePoint now) {
  const bool is_recent = now - std::exchange(last_loss_, now) <= memory;
  if (on_trial_) {
    const std::string filter = *std::exchange(on_trial_, std::nullopt);
    const auto known = records_.find(filter);
    if (known == records_.end() || ++known->second.losses_alone < losses_alone) return std::nullopt;
    set_aside(filter, now);
    return filter;
  }
  for (auto& [filter, record] : records_) {
    const unsigned before = is_recent ? record.losses : 0;
    record.losses = record.is_under_way ? before + 1 : 0;
    record.is_under_way = false;
  }
  return std::nullopt;
}

void FilterSuspects::set_aside(const std::string& filter, TimePoint now) {
  records_.erase(filter);
  if (aside_.size() >= most_aside)
    aside_.erase(std::ranges::min_element(aside_, {}, &decltype(aside_)::value_type::second));
  aside_[filter] = now + memory;
}

bool FilterSuspects::has_unanswered() const {
  return on_trial_ ||
         std::ranges::any_of(records_, [](const auto& each) { return each.second.is_under_way; });
}

bool FilterSuspects::has_suspects() const {
  return std::ranges::any_of(records_, [](const auto& each) { return each.second.is_suspect(); });
}

bool FilterSuspects::is_aside(const std::string& filter, TimePoint now) {
  const auto known = aside_.find(filter);
  if (known == aside_.end()) return false;
  if (now < known->second) return true;
  aside_.erase(known);
  return false;
}

std::optional<WantedSubscription> FilterSuspects::next_trial() {
  for (const auto& [filter, record] : records_) {
    if (!record.is_suspect()) continue;
    on_trial_ = filter;
    return WantedSubscription{filter, record.qos, record.id};
  }
  return std::nullopt;
}

void FilterSuspects::acquit_all() {
  on_trial_.reset();
  for (auto& [filter, record] : records_) record.losses = record.losses_alone = 0;
}

}  // namespace slamgw
