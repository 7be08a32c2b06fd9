// SPDX-License-Identifier: Apache-2.0
// Decides which robot messages are worth a line (`log.traffic`): a journal entry costs a Pi's card
// more than the message itself. Pure.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/line_budget.hpp"
#include "daemon/observability/log_settings.hpp"

namespace slamgw {

/// How many messages a line stands for.
struct TrafficLine {
  std::uint64_t of_stream = 1;  ///< this robot's, in this direction, of this type
  std::uint64_t of_others = 0;  ///< of any robot, left out because there were too many lines
};

/// `sampled`: the first of each robot, direction and type, then at most one a second, which says
/// how many it stands for.
class TrafficSampler {
 public:
  /// Streams that are sampled one by one; all further ones share one budget.
  static constexpr std::size_t max_streams = 65536;
  /// Never more than 9 000 lines in 30 s, where journald takes 10 000 of a service unless its unit
  /// says otherwise (RateLimitBurst= in journald.conf(5)). The rest is left for what matters.
  static constexpr std::int64_t lines_at_once = 3000;
  static constexpr std::int64_t lines_per_second = 200;

  explicit TrafficSampler(TrafficLogMode mode) : mode_(mode) {}

  /// What the line for this message stands for; nothing when it gets no line.
  std::optional<TrafficLine> on_traffic(const TrafficEvent& event, TimePoint now);

 private:
  std::optional<std::uint64_t> sample(const TrafficEvent& event, TimePoint now);

  TrafficLogMode mode_;
  LineBudget budget_{lines_at_once, lines_per_second};
  std::uint64_t without_line_ = 0;
  /// By the hash of robot, type and direction; two streams that share one share their lines.
  std::unordered_map<std::size_t, LogThrottle> streams_;
  std::string stream_;  // of the current message; kept, so that its memory is reused
};

}  // namespace slamgw
