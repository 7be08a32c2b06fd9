// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/arrivals.hpp"

#include <algorithm>

namespace slamgw::bench {

Percentiles percentiles_of(std::vector<std::int64_t>& latencies_ns) {
  if (latencies_ns.empty()) return {};
  std::sort(latencies_ns.begin(), latencies_ns.end());
  const auto at = [&](double part) {
    const auto last = static_cast<double>(latencies_ns.size() - 1);
    return static_cast<double>(latencies_ns[static_cast<std::size_t>(last * part)]) / 1e6;
  };
  return {at(0.5), at(0.99), at(0.999), at(1.0)};
}

void Arrivals::on_payload(ByteView payload, Clock::time_point now) {
  const auto message = from_payload(payload);
  if (!message) return;
  if (message->run != run_) {
    if (others_.count++ == 0) others_.first = now;
    others_.last = now;
    return;
  }
  if (message->client >= seen_.size()) return;
  std::vector<bool>& seen = seen_[message->client];
  if (message->sequence >= seen.size()) seen.resize(message->sequence + 64);
  if (seen[message->sequence]) {
    ++duplicates_;
    return;
  }
  seen[message->sequence] = true;
  latencies_ns_.push_back(to_ns(now) - message->due_ns);
  last_ = now;
}

}  // namespace slamgw::bench
