// SPDX-License-Identifier: Apache-2.0
#include "web/server/client_counts.hpp"

#include <algorithm>

namespace slamgw::web {

unsigned ClientCounts::add(const Client& client, TimePoint now) {
  if (counts_.size() >= max_clients && !counts_.contains(client.name))
    counts_.erase(std::min_element(
        counts_.begin(), counts_.end(),
        [](const auto& a, const auto& b) { return a.second.last < b.second.last; }));
  Count& count = counts_[client.name];
  if (now - count.last > quiet_time) count.events = 0;
  count.last = now;
  ++total_;
  return ++count.events;
}

}  // namespace slamgw::web
