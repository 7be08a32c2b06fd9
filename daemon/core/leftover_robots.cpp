// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/leftover_robots.hpp"

#include <string_view>
#include <utility>

#include "daemon/core/protocol_machine.hpp"

namespace slamgw {

void LeftoverRobots::on_broker_up(TimePoint now) {
  if (!up_since_) up_since_ = now;
  is_subscribed_ = is_collecting_;
  quiet_at_.reset();
}

bool LeftoverRobots::take(const BrokerMessage& message, TimePoint now) {
  const std::string_view prefix(filter_.data(), filter_.size() - 1);  // without the "+"
  if (!is_collecting_ || !message.topic.starts_with(prefix)) return false;
  if (message.retain && quiet_at_) quiet_at_ = now + retained_patience;
  const bool is_presence = !message.payload.empty() && message.payload.size() <= max_octets;
  if (message.retain && is_presence && found_.size() < max_robots)
    found_[message.topic.substr(prefix.size())].assign(message.payload.begin(),
                                                       message.payload.end());
  return true;
}

std::optional<TimePoint> LeftoverRobots::deadline() const {
  if (!is_collecting_ || !up_since_) return std::nullopt;
  return earlier(*up_since_ + grace, quiet_at_);
}

void LeftoverRobots::on_granted(const std::string& filter, TimePoint now) {
  if (filter == filter_ && is_subscribed_) quiet_at_ = now + retained_patience;
}

bool LeftoverRobots::end_subscription(TimePoint now) {
  if (!is_subscribed_ || (is_collecting_ && (!quiet_at_ || now < *quiet_at_))) return false;
  is_subscribed_ = false;
  quiet_at_.reset();
  return true;
}

std::optional<std::vector<LeftoverRobots::Leftover>> LeftoverRobots::finish(TimePoint now) {
  if (!is_collecting_ || !up_since_ || now - *up_since_ < grace) return std::nullopt;
  is_collecting_ = false;
  std::vector<Leftover> all;
  for (auto& [robot, presence] : std::exchange(found_, {}))
    all.push_back({robot, std::move(presence)});
  return all;
}

}  // namespace slamgw
