// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/leftover_robots.hpp"

#include <utility>

namespace slamgw {

void LeftoverRobots::on_broker_up(TimePoint now) {
  if (!up_since_) up_since_ = now;
}

bool LeftoverRobots::take(const BrokerMessage& message) {
  if (!message.topic.starts_with(root_)) return false;
  const bool is_presence = !message.payload.empty() && message.payload.size() <= max_octets;
  if (is_collecting_ && message.retain && is_presence && found_.size() < max_robots)
    found_[message.topic.substr(root_.size())].assign(message.payload.begin(),
                                                      message.payload.end());
  return true;
}

std::optional<TimePoint> LeftoverRobots::deadline() const {
  if (!is_collecting_ || !up_since_) return std::nullopt;
  return *up_since_ + grace;
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
