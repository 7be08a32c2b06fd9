// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/token_bucket.hpp"

#include <algorithm>
#include <chrono>

namespace slamgw::mqttsn {

bool TokenBucket::take(unsigned burst, Duration interval, TimePoint now) {
  const TimePoint after = std::max(taken_until_, now) + interval;
  if (after - now > interval * burst) return false;
  taken_until_ = after;
  return true;
}

bool TokenBucket::take(unsigned burst, unsigned per_second, TimePoint now) {
  return take(burst, std::chrono::nanoseconds(std::chrono::seconds{1}) / per_second, now);
}

}  // namespace slamgw::mqttsn
